//! Grouping of events into batches, and the order of writing and sending.

use super::*;

#[test]
fn batch_is_complete_at_max_nodes_bytes_or_age() {
    let mut agent = Agent::new_welcomed(SendingConfig { batch_nodes: 3, ..config() });
    agent.offer(7);
    assert_eq!(agent.sent.iter().map(|head| head.events).collect::<Vec<_>>(), [3, 3]);
    assert_eq!(agent.sending.deadline(), Some(at(200).mono));
    agent.advance_ms(199);
    assert_eq!(agent.sent.len(), 2);
    agent.advance_ms(1);
    assert_eq!(agent.sent.iter().map(|head| head.events).collect::<Vec<_>>(), [3, 3, 1]);

    // Batch 3 has one event.
    let event_bytes = agent.file.batches[&3].body.len();
    let mut agent =
        Agent::new_welcomed(SendingConfig { batch_nodes: 100, batch_bytes: 2 * event_bytes, ..config() });
    agent.offer(3);
    assert_eq!(agent.take_sent_numbers(), [1]);
    let long_event = incident(&"x".repeat(10 * event_bytes));
    agent.sending.offer(&long_event, agent.now());
    agent.sending.offer(&incident("event 0"), agent.now());
    agent.settle();
    assert_eq!(
        agent.sent.iter().map(|head| head.events).collect::<Vec<_>>(),
        [1, 1],
        "a long event forms a batch alone"
    );
}

#[test]
fn batches_are_consecutive_and_spooled_before_sending() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(3);
    assert_eq!(agent.take_sent_numbers(), [1, 2, 3]);
    assert_eq!(agent.file.newest.0, 3);
    let state = agent.file.state();
    assert_eq!((state.waiting_usage.events, state.totals.produced), (3, 3));
    agent.sending.offer(&incident("a"), agent.now());
    agent.sending.offer(&incident("b"), agent.now());
    let Some(Action::Append { batches, totals }) = agent.sending.next(agent.now().mono) else {
        panic!("expected an append")
    };
    assert_eq!((batches.len(), batches[0].number), (1, 4));
    assert_eq!(
        totals,
        Totals {
            produced: 4,
            dropped: 0,
            gaps: 0,
            reported_drops: 0,
            submitted: totals.submitted.clone(),
            newest_sendable: Some(NewestSendableBatch { process: 1, number: 4 }),
            unreported: None,
        }
    );
    assert_eq!(totals.submitted.settled().events.total, 4);
    agent.ack(3);
    assert!(agent.take_sent_numbers().is_empty(), "batch 4 is not written yet");
    agent.perform(Action::Append { batches, totals });
    agent.settle();
    assert_eq!(agent.take_sent_numbers(), [4]);
}

#[test]
fn many_batches_are_written_at_once_while_disk_is_slow() {
    let mut agent = Agent::new(config());
    let events = 600;
    (0..events).for_each(|n| agent.sending.offer(&incident(&n.to_string()), agent.now()));
    agent.sending.flush(agent.now().wall);
    let mut appends = Vec::new();
    while let Some(action) = agent.sending.next(agent.now().mono) {
        let Action::Append { batches, .. } = &action else { continue };
        appends.push(batches.len());
        assert_eq!(agent.sending.next(agent.now().mono), None, "only one write is requested at a time");
        agent.perform(action);
    }
    assert_eq!(appends, [256, 256, 88]);
    assert!(agent.sending.is_spooled() && !agent.sending.is_idle());
}

#[test]
fn flush_writes_all_events_to_spool() {
    let mut agent = Agent::new(SendingConfig { batch_nodes: 100, ..config() });
    agent.offer(5);
    assert!(!agent.sending.is_spooled());
    agent.sending.flush(agent.now().wall);
    agent.settle();
    assert!(agent.sending.is_spooled());
    assert_eq!(agent.file.state().waiting_usage.events, 5);
    assert_eq!(agent.sending.goodbye(), None, "no aggregator has accepted the host");
    let mut agent = agent.restart();
    agent.connect();
    agent.welcome(0, None);
    assert_eq!(agent.deliver(), [1]);
    assert!(agent.sending.is_idle() && agent.sending.goodbye().is_some() && !agent.sending.is_up());
}
