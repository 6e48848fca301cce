//! Batches that are missing from the file, although the agent did not delete them.

use super::*;

/// Returns an agent whose file contained ten batches, of which the batches with these numbers are missing.
fn agent_with_missing_batches(numbers: &[u64]) -> Agent {
    let mut agent = Agent::new(config());
    agent.offer_batches(10);
    numbers.iter().for_each(|number| assert!(agent.file.batches.remove(number).is_some()));
    let state = agent.file.state();
    let mut agent = agent.restart();
    // The state of the file counts the missing batches, too, as if they were deleted after the file was opened. Each
    // missing body counts as 10 bytes.
    let lost = numbers.len() as u64;
    let waiting_usage =
        Usage { events: state.waiting_usage.events + lost, bytes: state.waiting_usage.bytes + lost * 10 };
    let description = agent.sending.host.clone();
    let process = 1;
    agent.sending = Sending::new(
        agent.config,
        description,
        HostSecret::random(),
        process,
        SpoolState { waiting_usage, ..state },
    );
    agent
}

#[test]
fn missing_batches_are_skipped_counted_and_reported() {
    let mut agent = agent_with_missing_batches(&[4, 5]);
    agent.connect();
    agent.welcome(0, None);
    assert_eq!(agent.deliver(), [1, 2, 3]);
    // The chain hash of batch 6, the first batch after the gap, cannot be checked. The agent therefore skips it, too.
    let hello = agent.hellos.last().expect("a hello").clone();
    assert_eq!((agent.hellos.len(), hello.oldest, hello.first), (2, 7, 1));
    agent.welcome(3, None);
    // The skipped batches count as acknowledged, so the notice says that the aggregator lacks acknowledged batches.
    assert!(matches!(agent.notices.last(), Some(Notice::Welcomed { aggregator_lost_batches: true, .. })));
    agent.advance_ms(1_000);
    assert_eq!(agent.deliver(), [7, 8, 9, 10, 11], "the last batch reports the missing events");
    let accounting = agent.accounting();
    assert_eq!((accounting.dropped, accounting.gaps, accounting.stored, accounting.waiting), (3, 1, 8, 0));
    agent.advance_ms(1_000);
    let accounting = agent.accounting();
    assert_eq!(accounting.spool_bytes, 0);
    assert_eq!(agent.file.batches.len(), 0);
}

#[test]
fn missing_batches_at_end_are_skipped() {
    let mut agent = agent_with_missing_batches(&[8, 9, 10]);
    agent.connect();
    agent.welcome(0, None);
    assert_eq!(agent.deliver(), (1..=7).collect::<Vec<_>>());
    agent.offer_batches(2);
    agent.welcome(7, None);
    assert_eq!(agent.deliver(), [11, 12, 13]);
    assert_eq!((agent.accounting().dropped, agent.accounting().waiting), (3, 0));
}

#[test]
fn agent_continues_if_all_batches_are_missing() {
    // Batch 1 is deleted last, because a file that is opened without any batch has no missing batches.
    let mut agent = agent_with_missing_batches(&(2..=10).collect::<Vec<_>>());
    agent.file.batches.clear();
    agent.connect();
    agent.welcome(0, None);
    assert_eq!(agent.hellos.last().map(|hello| hello.oldest), Some(11));
    agent.welcome(0, None);
    agent.advance_ms(200);
    assert_eq!(agent.deliver(), [11]);
    assert!(agent.sending.is_idle());
    assert_eq!(agent.accounting().dropped, 10);
}

#[test]
fn missing_batches_at_several_positions_are_skipped() {
    let mut agent = agent_with_missing_batches(&[2, 5, 8]);
    agent.connect();
    let mut delivered = Vec::new();
    let mut stored = 0;
    for _ in 0..5 {
        agent.welcome(stored, None);
        delivered.extend(agent.deliver());
        agent.advance_ms(200);
        stored = delivered.last().copied().unwrap_or(0);
    }
    assert_eq!(delivered, [1, 4, 7, 10, 11]);
    assert!(agent.sending.is_idle());
    assert_eq!(agent.accounting().dropped, 6);
}

#[test]
fn missing_compared_batch_causes_stream_renewal() {
    let mut agent = agent_with_missing_batches(&[6]);
    agent.connect();
    agent.welcome(6, Some(ChainHash::from_bytes([9; 16])));
    assert!(agent.notices.contains(&Notice::StreamRenewed { stored: 6, newest: 10 }));
    agent.welcome(0, None);
    assert_eq!(agent.deliver(), [1, 2, 3, 4, 5]);
    agent.welcome(5, None);
    agent.advance_ms(200);
    assert_eq!(agent.deliver(), [8, 9, 10, 11]);
}
