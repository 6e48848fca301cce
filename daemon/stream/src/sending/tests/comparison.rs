//! Comparison of both ends' batches before anything is deleted.

use super::*;

/// Chain hash that no batch of the agent's spool has.
const OTHER_CHAIN: Option<ChainHash> = Some(ChainHash::from_bytes([9; 16]));

/// Returns an agent with unacknowledged batches in the file. A process with a connection created the first
/// `before_restart` batches. Then a process without a connection created `after_restart` batches.
fn agent_with_unacknowledged(before_restart: usize, after_restart: usize) -> Agent {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(before_restart);
    let mut agent = agent.restart();
    agent.offer_batches(after_restart);
    agent.restart()
}

fn renewals(agent: &Agent) -> usize {
    agent.count_actions(|action| matches!(action, Action::Renew { .. }))
}

#[test]
fn stored_batches_are_deleted_when_chains_match() {
    for stored in [0, 1, 7, 10] {
        let mut agent = agent_with_unacknowledged(10, 0);
        agent.connect();
        let chain = agent.chain(stored);
        agent.welcome(stored, chain);
        let welcomed = Notice::Welcomed {
            aggregator: "base".parse().expect("a name"),
            stored,
            aggregator_lost_batches: false,
        };
        assert_eq!(agent.notices, [welcomed]);
        assert_eq!(agent.deliver(), (stored + 1..=10).collect::<Vec<_>>());
        assert_eq!(agent.accounting().stored, 10);
        assert_eq!(renewals(&agent), 0);
        agent.advance_ms(1_000);
        assert_eq!(agent.file.batches.len(), 0);
    }
}

#[test]
fn nothing_is_deleted_or_sent_before_comparison() {
    let mut agent = agent_with_unacknowledged(10, 0);
    agent.config.batch_bytes = 40;
    let mut agent = agent.restart();
    agent.connect();
    let (stream, chain) = (agent.file.stream, agent.chain(9));
    let aggregator = "base".parse().expect("a name");
    let welcome = ToAgent::Welcome { aggregator, stream, stored: 9, chain, process: None, window: 8 };
    assert_eq!(agent.sending.on_message(&welcome, at(0)), None);
    let Some(load @ Action::Load { .. }) = agent.sending.next(at(0).mono) else { panic!("expected a load") };
    assert_eq!(agent.sending.next(at(0).mono), None);
    // The connection ends meanwhile, so the answer of the disk must have no effect.
    agent.sending.on_disconnected();
    agent.perform(load);
    agent.advance_ms(5_000);
    assert_eq!((agent.file.batches.len(), agent.sent.len()), (10, 0));
    agent.connect();
    agent.receive(&welcome);
    assert_eq!(agent.deliver(), [10]);
}

#[test]
fn spool_that_lost_its_end_sends_no_batch_twice() {
    // Process 1 sent 15 batches, and the aggregator stored them. The spool lost the last five batches. Process 3 then
    // creates two other batches, with the numbers 11 and 12.
    let mut agent = agent_with_unacknowledged(10, 0);
    agent.offer_batches(2);
    let old_stream = agent.file.stream;
    agent.connect();
    agent.welcome_with_process(15, OTHER_CHAIN, Some(1));
    assert_eq!(agent.notices, [Notice::StreamRenewed { stored: 15, newest: 12 }]);
    let hello = agent.hellos.last().expect("a hello").clone();
    assert_eq!((hello.first, hello.oldest, hello.previous_stream), (11, 11, Some(old_stream)));
    assert_ne!(hello.stream, old_stream);
    assert!(agent.chain(11).is_some(), "batch 11 is in the file");
    assert_eq!(hello.chain_before_oldest, agent.file.previous_chain);
    agent.welcome(10, None);
    assert_eq!(agent.deliver(), [11, 12], "only the batches that were never sent");
    assert_eq!(agent.accounting().stored, 12);
}

#[test]
fn unsent_batches_are_distinguished_from_sent_batches_after_restart() {
    // Process 2, which had no connection, wrote batches 11 to 13 after the sent batches. Process 4 adds batches 14 and
    // 15. The spool lost the batches 11 to 14 that process 1 sent.
    let mut agent = agent_with_unacknowledged(10, 3).restart();
    agent.offer_batches(2);
    agent.connect();
    agent.welcome_with_process(14, OTHER_CHAIN, Some(1));
    agent.welcome(10, None);
    assert_eq!(agent.deliver(), (11..=15).collect::<Vec<_>>());
    assert_eq!(renewals(&agent), 1);
}

#[test]
fn newest_sendable_batch_is_recorded_per_process() {
    // Process 1 sent batches 1 to 10, and process 3 sent batches up to 14. In each case, the spool lost the last
    // batches of one of the two processes, which the aggregator has stored.
    let mut agent = agent_with_unacknowledged(10, 0);
    agent.connect();
    agent.welcome(0, None);
    agent.offer_batches(4);
    for (process, first) in [(1, 11), (3, 15)] {
        let file = agent.file.clone();
        let mut agent = Agent::open(agent.config, agent.host, file);
        agent.offer_batches(1);
        agent.connect();
        agent.welcome_with_process(17, OTHER_CHAIN, Some(process));
        assert_eq!(agent.hellos.last().map(|hello| hello.first), Some(first));
        agent.welcome(first - 1, None);
        assert_eq!(agent.deliver(), (first..=15).collect::<Vec<_>>());
    }
}

#[test]
fn copied_spool_keeps_batches_of_another_process() {
    // The original spool continued with process 9, or with an unknown process. In the last case, process 1 sent
    // the last stored batch, but this batch differs from batch 8 in this spool.
    for (stored, process) in [(15, Some(9)), (15, None), (11, Some(9)), (8, Some(9)), (8, Some(1))] {
        let mut agent = agent_with_unacknowledged(10, 3);
        agent.connect();
        agent.welcome_with_process(stored, OTHER_CHAIN, process);
        assert_eq!(agent.hellos.last().map(|hello| hello.first), Some(1), "{stored} {process:?}");
        agent.welcome(0, None);
        assert_eq!(agent.deliver(), (1..=13).collect::<Vec<_>>());
    }
}

#[test]
fn mark_without_chain_deletes_nothing() {
    let mut agent = agent_with_unacknowledged(10, 0);
    agent.connect();
    agent.welcome(7, None);
    assert_eq!(agent.file.batches.len(), 10);
    assert_eq!(renewals(&agent), 1);
    agent.welcome(0, None);
    assert_eq!(agent.deliver().len(), 10);
}

#[test]
fn aggregator_without_acknowledged_batches_is_reported() {
    // A new database, an older copy of the database, and a copy from the time of an earlier process.
    for (stored, chain, process) in [(0, None, None), (5, OTHER_CHAIN, Some(2)), (2, OTHER_CHAIN, Some(1))] {
        let mut agent = agent_with_deleted_batches();
        agent.welcome_with_process(stored, chain, process);
        let aggregator = "base".parse().expect("a name");
        assert_eq!(
            agent.notices.last(),
            Some(&Notice::Welcomed { aggregator, stored, aggregator_lost_batches: true })
        );
        assert_eq!(agent.hellos.last().map(|hello| (hello.first, hello.oldest)), Some((1, 7)));
        agent.ack(8);
        assert!(agent.sending.is_idle());
    }
}

#[test]
fn aggregator_with_batches_of_copy_gets_new_stream() {
    // Process 9 never wrote to this spool, and process 1 sent only four batches from it. The stored batches are
    // therefore of a copy.
    for (stored, process) in [(2, Some(9)), (5, Some(1))] {
        let mut agent = agent_with_deleted_batches();
        agent.welcome_with_process(stored, OTHER_CHAIN, process);
        assert_eq!(agent.hellos.last().map(|hello| (hello.first, hello.oldest)), Some((7, 7)));
        agent.welcome(6, None);
        assert_eq!(agent.deliver(), [7, 8]);
    }
}

/// Returns an agent that has two batches and sends another hello. The batches before these two are stored: four batches
/// of the agent's first process, and two of its second process.
fn agent_with_deleted_batches() -> Agent {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(4);
    agent.deliver();
    agent.advance_ms(1_000);
    let mut agent = agent.restart();
    agent.connect();
    let chain = Some(agent.file.previous_chain);
    agent.welcome_with_process(4, chain, Some(1));
    agent.offer_batches(2);
    agent.deliver();
    agent.offer_batches(2);
    agent.take_sent_numbers();
    agent.receive(&ToAgent::Unknown);
    agent
}

#[test]
fn nothing_is_sent_during_stream_renewal() {
    let mut agent = agent_with_unacknowledged(4, 0);
    agent.connect();
    agent.spool_is_broken = true;
    agent.welcome_with_process(9, OTHER_CHAIN, Some(1));
    assert_eq!(agent.notices.len(), 2, "{:?}", agent.notices);
    let hellos = agent.hellos.len();
    agent.offer_batches(3);
    agent.welcome(4, OTHER_CHAIN);
    agent.advance_ms(30_000);
    assert_eq!((agent.hellos.len(), agent.sent.len()), (hellos, 0));
    agent.spool_is_broken = false;
    agent.advance_ms(1_000);
    agent.welcome(4, None);
    assert_eq!(agent.deliver(), [5, 6, 7]);
    assert_eq!(agent.accounting().dropped, 0);
}

#[test]
fn stream_renewal_without_connection_sends_no_hello() {
    let mut agent = agent_with_unacknowledged(4, 0);
    let old_stream = agent.file.stream;
    agent.connect();
    agent.spool_is_broken = true;
    agent.welcome_with_process(9, OTHER_CHAIN, Some(1));
    agent.sending.on_disconnected();
    let hellos = agent.hellos.len();
    agent.spool_is_broken = false;
    (0..2).for_each(|_| agent.advance_ms(1_000));
    assert_eq!((renewals(&agent), agent.hellos.len()), (1, hellos));
    agent.connect();
    assert_eq!(agent.hellos.len(), hellos + 1);
    assert_eq!(agent.hellos[hellos].previous_stream, Some(old_stream));
}

#[test]
fn large_file_is_compared_without_being_kept_in_memory() {
    let mut agent = Agent::new_welcomed(SendingConfig { batch_bytes: 200, ..config() });
    agent.offer_batches(500);
    let mut agent = agent.restart();
    agent.connect();
    let chain = agent.chain(400);
    agent.welcome(400, chain);
    assert_eq!(agent.deliver(), (401..=500).collect::<Vec<_>>());
    let requested_bytes = agent.actions.iter().filter_map(|action| match action {
        Action::Load { bytes, .. } => Some(*bytes),
        _ => None,
    });
    assert!(requested_bytes.max() <= Some(200 * 2));
    assert_eq!(agent.accounting().stored, 500);
}
