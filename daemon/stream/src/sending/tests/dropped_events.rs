//! Events for which neither the spool nor the memory has space: they are dropped and counted, and the counts add up.

use super::super::super::{EndReason, RunEnded};
use super::*;
use peernet_logger::RunId;

#[test]
fn full_spool_drops_newest_events_and_reports_gap() {
    let mut agent = Agent::new(SendingConfig { spool_bytes: 4_000, ..config() });
    agent.offer(200);
    let accounting = agent.accounting();
    assert!(
        accounting.dropped > 10 && accounting.waiting > 10 && accounting.spool_bytes <= 4_000,
        "{accounting:?}"
    );
    assert_eq!((accounting.spool_limit_bytes, accounting.gaps), (4_000, 0));
    let (waiting, dropped) = (accounting.waiting, accounting.dropped);
    agent.connect();
    agent.welcome(0, None);
    agent.deliver();
    agent.advance_ms(1_000);
    agent.deliver();
    let accounting = agent.accounting();
    assert_eq!(
        (accounting.stored, accounting.dropped, accounting.gaps, accounting.waiting),
        (waiting + 1, dropped, 1, 0)
    );
}

#[test]
fn deletion_frees_capacity_for_new_events() {
    let mut agent = Agent::new_welcomed(SendingConfig { spool_bytes: 4_000, ..config() });
    for _ in 0..100 {
        agent.offer(1);
        agent.deliver();
    }
    assert_eq!(agent.accounting().dropped, 0, "deletions are requested early enough");
}

#[test]
fn events_wait_in_memory_for_slow_disk() {
    let memory = Usage { events: 1_000, bytes: 2_000 };
    let mut agent = Agent::new(SendingConfig { memory, batch_nodes: 100, ..config() });
    // The first batch is being written all the time, because the test performs no action of the spool.
    (0..200).for_each(|n| agent.sending.offer(&incident(&n.to_string()), agent.now()));
    let accounting = agent.accounting();
    assert!(
        accounting.memory_bytes <= 2_000 && accounting.waiting > 10 && accounting.dropped > 100,
        "{accounting:?}"
    );
}

#[test]
fn totals_continue_after_restart() {
    let mut agent = Agent::new_welcomed(SendingConfig { spool_bytes: 4_000, ..config() });
    agent.sending.on_disconnected();
    agent.offer(200);
    agent.sending.flush(agent.now().wall);
    agent.settle();
    let before = agent.accounting();
    let mut agent = agent.restart();
    assert_eq!(agent.accounting().dropped, before.dropped, "the flush wrote the number of dropped events");
    // The new process has sent no batch yet, so only stored events count as sent.
    assert_eq!(agent.accounting(), Accounting { sent: agent.accounting().stored, ..before });
    agent.connect();
    agent.welcome(0, None);
    agent.deliver();
    let stored = agent.accounting().stored;
    assert_eq!(stored, before.waiting);
    agent.advance_ms(1_000);
    let agent = agent.restart();
    assert_eq!((agent.accounting().stored, agent.accounting().waiting), (stored, 0));
}

#[test]
fn gap_is_reported_before_end_of_run() {
    let run = RunId::random();
    let memory = Usage { events: 4, bytes: 1 << 20 };
    let mut agent = Agent::new(SendingConfig { memory, batch_nodes: 100, ..config() });
    agent.offer(8);
    assert_eq!(agent.accounting().dropped, 4);
    agent.advance_ms(200);
    let ended = RunEnded { run, ended: agent.now().wall, reason: EndReason::Finished };
    agent.sending.offer(&Event::RunEnded(ended), agent.now());
    agent.sending.flush(agent.now().wall);
    agent.settle();
    let accounting = agent.accounting();
    assert_eq!((accounting.gaps, accounting.waiting), (1, 6));
    let batch = agent.file.batches.values().next_back().expect("a batch");
    let events = codec::decode_events(&batch.body, batch.events).expect("the events are readable");
    assert!(matches!(&events[0], Event::Gap(gap) if gap.count == 4), "{events:?}");
}
