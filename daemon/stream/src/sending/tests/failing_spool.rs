//! Sending from memory while the spool fails.

use super::super::super::Gap;
use super::*;

/// Returns an agent whose disk begins to fail after three batches were delivered.
fn agent_with_failing_disk() -> Agent {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(3);
    agent.deliver();
    agent.advance_ms(1_000);
    agent.spool_is_broken = true;
    agent
}

#[test]
fn batches_are_sent_from_memory_while_disk_is_full() {
    let mut agent = agent_with_failing_disk();
    agent.offer_batches(7);
    let reason = "the disk is full";
    assert_eq!(agent.notices[1..], [Notice::SpoolFailed(reason.into())]);
    assert_eq!(agent.take_sent_numbers(), [4, 5, 6]);
    let accounting = agent.accounting();
    assert_eq!((accounting.trouble.as_deref(), accounting.waiting, accounting.sent), (Some(reason), 7, 6));
    assert!(accounting.memory_bytes > 0);
    agent.ack(6);
    assert_eq!(agent.take_sent_numbers(), [7, 8, 9]);
    agent.spool_is_broken = false;
    agent.actions.clear();
    agent.advance_ms(1_000);
    assert_eq!(agent.notices.last(), Some(&Notice::SpoolRecovered));
    // The file records first the deletion of the stored batches, then that batches up to number 6 may have been sent,
    // then the batches that are not stored.
    let [
        Action::Delete { through: 6, .. },
        Action::Append { batches: no_batches, totals },
        Action::Append { batches, .. },
    ] = &agent.actions[..]
    else {
        panic!("{:?}", agent.actions)
    };
    assert_eq!(
        (no_batches.len(), totals.newest_sendable.map(|newest| newest.number), batches.len()),
        (0, Some(6), 4)
    );
    assert_eq!(agent.file.batches.keys().copied().collect::<Vec<_>>(), [7, 8, 9, 10]);
    agent.ack(9);
    assert_eq!(agent.deliver(), [10]);
    assert!(agent.sending.is_idle());
    assert_eq!(agent.accounting().stored, 10);
    agent.advance_ms(1_000);
    assert_eq!((agent.accounting().spool_bytes, agent.file.batches.len()), (0, 0));
}

#[test]
fn failure_and_recovery_are_reported_once() {
    let mut agent = agent_with_failing_disk();
    agent.offer_batches(2);
    (0..20).for_each(|_| agent.advance_ms(1_000));
    assert!(agent.count_actions(|action| matches!(action, Action::Append { .. })) > 10);
    agent.spool_is_broken = false;
    agent.advance_ms(1_000);
    let reported = |agent: &Agent| {
        agent.notices.iter().filter(|notice| !matches!(notice, Notice::Welcomed { .. })).count()
    };
    assert_eq!(reported(&agent), 2, "{:?}", agent.notices);
}

#[test]
fn acknowledgement_during_write_deletes_batch_after_write() {
    for fails in [false, true] {
        let mut agent = agent_with_failing_disk();
        agent.offer_batches(2);
        assert_eq!(agent.take_sent_numbers(), [4, 5]);
        agent.millis += 1_000;
        let retry = agent.sending.next(agent.now().mono).expect("the write is tried again");
        assert!(matches!(&retry, Action::Append { batches, .. } if batches.len() == 2));
        agent.ack(4);
        agent.spool_is_broken = fails;
        agent.perform(retry);
        agent.settle();
        agent.spool_is_broken = false;
        agent.advance_ms(2_000);
        assert_eq!(agent.file.batches.keys().copied().collect::<Vec<_>>(), [5]);
        assert_eq!(agent.accounting().spool_bytes, agent.file.batches[&5].body.len() as u64);
        agent.ack(5);
        agent.advance_ms(2_000);
        assert_eq!((agent.accounting().spool_bytes, agent.accounting().stored), (0, 5));
    }
}

#[test]
fn no_batch_is_repeated_after_kill_with_full_disk() {
    // Two batches are in the file, acknowledged but not deleted; two more were stored from memory.
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(2);
    agent.spool_is_broken = true;
    agent.deliver();
    agent.offer_batches(3);
    assert_eq!(agent.take_sent_numbers(), [3, 4, 5]);
    agent.ack(4);
    let mut agent = agent.restart();
    assert_eq!((agent.file.newest.0, agent.file.batches.len()), (2, 2));
    agent.offer_batches(2);
    agent.connect();
    agent.welcome_with_process(4, Some(ChainHash::from_bytes([9; 16])), Some(1));
    agent.welcome(2, None);
    assert_eq!(agent.deliver(), [3, 4], "the new batches have the first numbers of the new stream");
    let accounting = agent.accounting();
    assert_eq!(
        (accounting.produced, accounting.stored, accounting.waiting),
        (4, 4, 0),
        "the counts are those of the file"
    );
}

#[test]
fn unspooled_batches_wait_until_file_records_sending() {
    // A process without a connection wrote two batches. The next process meets the aggregator and a full disk at the
    // same time.
    let mut agent = Agent::new(config());
    agent.offer_batches(2);
    let mut agent = agent.restart();
    agent.spool_is_broken = true;
    agent.offer_batches(2);
    agent.connect();
    agent.welcome(0, None);
    assert!(agent.take_sent_numbers().is_empty(), "the file cannot be read either");
    agent.spool_is_broken = false;
    agent.advance_ms(1_000);
    assert_eq!(agent.file.newest_sendable, [NewestSendableBatch { process: 2, number: 4 }]);
    assert_eq!(agent.deliver(), [1, 2, 3, 4]);
}

#[test]
fn events_beyond_disk_and_memory_are_counted_as_dropped() {
    let memory = Usage { events: 6, bytes: 1 << 20 };
    let mut agent = Agent::new(SendingConfig { memory, ..config() });
    agent.spool_is_broken = true;
    agent.offer(20);
    let accounting = agent.accounting();
    assert_eq!((accounting.waiting, accounting.dropped, accounting.gaps), (6, 14, 0));
    agent.spool_is_broken = false;
    agent.advance_ms(1_000);
    assert_eq!(agent.accounting().gaps, 1);
    agent.connect();
    agent.welcome(0, None);
    agent.advance_ms(1_000);
    assert_eq!(agent.deliver(), (1..=7).collect::<Vec<_>>(), "six events and the gap");
    let accounting = agent.accounting();
    assert_eq!((accounting.produced, accounting.stored, accounting.dropped), (21, 7, 14));
}

/// Returns the gaps in the file.
fn gaps(file: &File) -> Vec<Gap> {
    let batches = file.batches.values();
    batches
        .flat_map(|batch| codec::decode_events(&batch.body, batch.events).expect("the events are readable"))
        .filter_map(|event| if let Event::Gap(gap) = event { Some(gap) } else { None })
        .collect()
}

/// Returns the number of events that the gaps in the file report.
fn reported_losses(file: &File) -> u64 {
    gaps(file).iter().map(|gap| gap.count).sum()
}

#[test]
fn losses_are_counted_while_disk_is_full() {
    let memory = Usage { events: 6, bytes: 1 << 20 };
    let mut agent = Agent::new(SendingConfig { memory, ..config() });
    agent.offer_batches(2);
    agent.rejects_batches = true;
    agent.offer(20);
    agent.advance_ms(1_000);
    agent.advance_ms(1_000);
    let accounting = agent.accounting();
    assert_eq!((accounting.waiting, accounting.dropped, agent.file.totals.dropped), (8, 14, 14));
    assert!(accounting.trouble.is_some(), "the failure remains after only counts are written");
    let failed = agent.notices.iter().filter(|notice| matches!(notice, Notice::SpoolFailed(_))).count();
    assert_eq!((failed, agent.notices.len()), (1, 1), "{:?}", agent.notices);
    // After a kill, the events in memory are unknown, but the file has the number of events that were dropped before.
    let mut agent = agent.restart();
    agent.offer_batches(1);
    let accounting = agent.accounting();
    assert_eq!(
        (accounting.produced, accounting.waiting, accounting.dropped, reported_losses(&agent.file)),
        (18, 4, 14, 14)
    );
    let gaps = gaps(&agent.file);
    let reason = &gaps.last().expect("the loss is reported").reason;
    assert_eq!(reason, "dropped before the agent last stopped; the reason was not stored");
}

#[test]
fn events_lost_with_memory_are_reported_after_restart() {
    let memory = Usage { events: 6, bytes: 1 << 20 };
    let mut agent = Agent::new(SendingConfig { memory, ..config() });
    agent.offer_batches(2);
    // The first loss is reported in a gap that is in the spool, the second loss in a gap that is not in the spool.
    agent.spool_is_broken = true;
    agent.offer(8);
    agent.spool_is_broken = false;
    (0..2).for_each(|_| agent.advance_ms(1_000));
    assert_eq!(reported_losses(&agent.file), 2);
    agent.rejects_batches = true;
    agent.offer(8);
    agent.sending.flush(agent.now().wall);
    agent.settle();
    assert!(!agent.sending.is_spooled() && !agent.sending.is_appending());
    let before = agent.accounting();
    let totals = agent.sending.give_up();
    agent.perform(Action::Append { batches: Vec::new(), totals });
    assert!(agent.sending.is_spooled());
    let accounting = agent.accounting();
    assert_eq!(
        (accounting.produced, accounting.waiting),
        (before.produced, agent.file.state().waiting_usage.events),
        "{accounting:?}"
    );
    assert_eq!(accounting.dropped, before.produced - accounting.waiting, "{accounting:?}");
    let mut agent = agent.restart();
    agent.offer_batches(1);
    assert_eq!(
        (agent.accounting().dropped, reported_losses(&agent.file)),
        (accounting.dropped, accounting.dropped)
    );
}
