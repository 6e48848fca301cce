//! A backlog in the file. The agent reads it ahead and sends it in order; the whole backlog is never in memory.

use super::*;

/// Length of a body. The agent keeps at most six such bodies in memory for sending: two windows of three batches.
const LONG_BODY_BYTES: usize = 1024;

fn agent_with_backlog(batches: usize) -> Agent {
    let mut agent = Agent::new(SendingConfig { batch_bytes: LONG_BODY_BYTES, ..config() });
    for _ in 0..batches {
        agent.sending.offer(&incident(&"x".repeat(LONG_BODY_BYTES - 100)), agent.now());
        agent.settle();
    }
    agent.advance_ms(1_000);
    agent
}

/// Returns the bytes of bodies in memory.
fn bytes_in_memory(agent: &Agent) -> u64 {
    agent.sending.spooler.backlog.waiting_usage().bytes
        - agent.sending.spooler.backlog.file_only_usage().bytes
}

#[test]
fn backlog_is_not_kept_in_memory() {
    let agent = agent_with_backlog(200);
    assert!(
        bytes_in_memory(&agent) <= 6 * LONG_BODY_BYTES as u64,
        "{} bytes in memory",
        bytes_in_memory(&agent)
    );
    // `memory_bytes` does not count batches that are also in the file.
    let accounting = agent.accounting();
    assert_eq!((accounting.waiting, accounting.spooled, accounting.memory_bytes), (200, 200, 0));
    assert_eq!(accounting.oldest, Some(at(0).wall));
}

#[test]
fn backlog_is_delivered_in_order_before_new_events() {
    for restart in [false, true] {
        let mut agent = agent_with_backlog(200);
        if restart {
            agent = agent.restart();
            assert_eq!(bytes_in_memory(&agent), 0);
            assert_eq!(agent.accounting().oldest, Some(at(0).wall));
        }
        agent.connect();
        agent.welcome(0, None);
        agent.offer(20);
        agent.advance_ms(200);
        let delivered = agent.deliver();
        assert_eq!(delivered, (1..=220).collect::<Vec<_>>());
        assert!(agent.sending.is_idle());
        assert_eq!(agent.accounting().stored, 220);
        agent.advance_ms(1_000);
        assert_eq!((agent.accounting().spool_bytes, agent.file.batches.len()), (0, 0));
    }
}

#[test]
fn file_is_read_while_batches_are_in_flight() {
    let mut agent = agent_with_backlog(40).restart();
    agent.connect();
    agent.welcome(0, None);
    let mut rounds_without_batch = 0;
    while !agent.sending.is_idle() {
        let Some(last) = agent.take_sent_numbers().last().copied() else { panic!("expected a sent batch") };
        // The answers of the disk come one round later than the answers of the aggregator.
        let (stream, now) = (agent.stream(), agent.now());
        agent.sending.on_message(&ToAgent::Ack { stream, through: last, window: 3 }, now);
        let mut jobs = Vec::new();
        while let Some(action) = agent.sending.next(now.mono) {
            match action {
                Action::Send(frame) => agent.record_frame(frame.into()),
                job => jobs.push(job),
            }
        }
        rounds_without_batch += usize::from(agent.sent.is_empty() && last < 40);
        assert!(bytes_in_memory(&agent) <= 6 * LONG_BODY_BYTES as u64);
        jobs.into_iter().for_each(|job| agent.perform(job));
        agent.settle();
    }
    assert_eq!(rounds_without_batch, 0, "the aggregator does not wait for the disk");
}

#[test]
fn waiting_events_are_not_older_than_last_stored_batch() {
    let mut agent = Agent::new(SendingConfig { batch_bytes: LONG_BODY_BYTES, ..config() });
    for _ in 0..40 {
        agent.advance_ms(1_000);
        agent.sending.offer(&incident(&"x".repeat(LONG_BODY_BYTES - 100)), agent.now());
        agent.settle();
    }
    agent.advance_ms(1_000);
    let millis = agent.millis;
    let mut agent = agent.restart();
    agent.millis = millis;
    agent.connect();
    agent.welcome(0, None);
    let mut stored = 0;
    while let Some(last) = agent.take_sent_numbers().last().copied() {
        stored = last;
        let (stream, now) = (agent.stream(), agent.now());
        agent.sending.on_message(&ToAgent::Ack { stream, through: stored, window: 3 }, now);
        // The disk does not answer, so no further batch is read.
        while let Some(action) = agent.sending.next(now.mono) {
            if let Action::Send(frame) = action {
                agent.record_frame(frame.into());
            }
        }
    }
    assert!((2..40).contains(&stored), "{stored}");
    // The first event of batch `n` was offered in second `n`.
    assert_eq!(agent.accounting().oldest, Some(at(1_000 * stored.cast_signed()).wall));
}

#[test]
fn unreadable_spool_is_read_again() {
    let mut agent = agent_with_backlog(20).restart();
    agent.spool_is_broken = true;
    agent.connect();
    agent.welcome(0, None);
    assert!(agent.take_sent_numbers().is_empty());
    assert!(
        matches!(&agent.notices[..], [Notice::SpoolFailed(reason), Notice::Welcomed { .. }] if reason == "the disk is full")
    );
    assert_eq!(agent.accounting().trouble.as_deref(), Some("the disk is full"));
    assert_eq!(agent.sending.deadline(), Some(at(1_000).mono));
    agent.spool_is_broken = false;
    agent.advance_ms(1_000);
    assert_eq!(agent.deliver(), (1..=20).collect::<Vec<_>>());
    assert_eq!(agent.notices.last(), Some(&Notice::SpoolRecovered));
    assert_eq!(agent.accounting().trouble, None);
}
