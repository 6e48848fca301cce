//! Batches in flight, and the behaviour without answers.

use super::super::super::MAX_IN_FLIGHT_BATCHES;
use super::*;

fn ack_with_window(agent: &mut Agent, through: u64, window: u32) {
    let stream = agent.stream();
    agent.receive(&ToAgent::Ack { stream, through, window });
}

#[test]
fn batches_in_flight_respect_windows_of_both_ends() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(10);
    assert_eq!(agent.take_sent_numbers(), [1, 2, 3], "limited by the agent's own window");
    ack_with_window(&mut agent, 1, 1);
    assert!(agent.take_sent_numbers().is_empty(), "limited by the aggregator's window");
    ack_with_window(&mut agent, 3, 1);
    assert_eq!(agent.take_sent_numbers(), [4]);
    ack_with_window(&mut agent, 4, 0);
    assert_eq!(agent.take_sent_numbers(), [5], "one batch is always allowed");
    ack_with_window(&mut agent, 5, u32::MAX);
    assert_eq!(agent.take_sent_numbers(), [6, 7, 8]);
}

#[test]
fn more_small_batches_than_large_batches_are_in_flight() {
    let config = SendingConfig { batch_bytes: 64 * 1_024, ..config() };
    let mut agent = Agent::new_welcomed(config);
    agent.offer_batches(300);
    // A small batch counts as 1 KiB. A window of three batches of 64 KiB therefore holds 3 × 64 small batches.
    assert_eq!(agent.take_sent_numbers(), (1..=3 * 64).collect::<Vec<_>>());
    ack_with_window(&mut agent, 64, 1);
    assert!(agent.take_sent_numbers().is_empty());
    ack_with_window(&mut agent, 130, 1);
    assert_eq!(agent.take_sent_numbers(), [193, 194]);
    let stream = agent.stream();
    agent.receive(&ToAgent::Resend { stream, from: 150 });
    assert_eq!(agent.take_sent_numbers(), (150..=194).collect::<Vec<_>>());
    // The number of batches in flight is limited, even if the batches are small.
    let mut agent = Agent::new_welcomed(SendingConfig { batch_bytes: 1 << 20, ..config });
    agent.offer_batches(1_100);
    assert_eq!(agent.take_sent_numbers().len(), MAX_IN_FLIGHT_BATCHES);
}

#[test]
fn requested_batch_is_sent_again() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(4);
    assert_eq!(agent.take_sent_numbers(), [1, 2, 3]);
    let stream = agent.stream();
    agent.receive(&ToAgent::Resend { stream, from: 2 });
    assert_eq!(agent.take_sent_numbers(), [2, 3]);
    agent.receive(&ToAgent::Resend { stream, from: 9 });
    agent.receive(&ToAgent::Resend { stream: StreamId::random(), from: 1 });
    assert!(agent.take_sent_numbers().is_empty());
    agent.ack(2);
    assert_eq!(agent.take_sent_numbers(), [4]);
    let hellos = agent.hellos.len();
    agent.receive(&ToAgent::Resend { stream, from: 1 });
    assert_eq!(
        (agent.hellos.len(), agent.hellos[hellos].oldest),
        (hellos + 1, 3),
        "a new hello states that batch 3 is the oldest remaining batch"
    );
}

#[test]
fn hello_after_unacknowledged_batches_is_repeated() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(2);
    assert_eq!(agent.take_sent_numbers(), [1, 2]);
    agent.advance_ms(9_000 - agent.millis);
    assert_eq!(agent.hellos.len(), 1);
    assert_eq!(agent.sending.deadline(), Some(at(10_000).mono));
    agent.advance_ms(1_000);
    assert_eq!(agent.hellos.len(), 2, "a hello is sent after 10 s without an acknowledgement");
    agent.advance_ms(250);
    agent.advance_ms(499);
    assert_eq!(agent.hellos.len(), 3);
    agent.advance_ms(1);
    assert_eq!(agent.hellos.len(), 4, "each pause is twice the previous pause");
    let chain = agent.chain(1);
    agent.welcome(1, chain);
    assert_eq!(agent.take_sent_numbers(), [2]);
    assert_eq!(agent.accounting().stored, 1);
}

#[test]
fn refused_hello_is_repeated_later() {
    let mut agent = Agent::new(config());
    agent.connect();
    agent.receive(&ToAgent::Refused { reason: "the name is taken".into() });
    assert_eq!(agent.notices, [Notice::Refused("the name is taken".into())]);
    agent.advance_ms(999);
    assert_eq!(agent.hellos.len(), 1);
    agent.advance_ms(1);
    assert_eq!(agent.hellos.len(), 2);
}

#[test]
fn hellos_without_progress_become_rare() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(1);
    for _ in 0..100 {
        agent.receive(&ToAgent::Unknown);
        agent.welcome(0, None);
    }
    assert!(agent.hellos.len() < 6, "{} hellos at one instant", agent.hellos.len());
    agent.advance_ms(20_000);
    agent.welcome(0, None);
    assert_eq!(agent.sent.last().map(|head| head.number), Some(1));
    agent.ack(1);
    let hellos = agent.hellos.len();
    agent.receive(&ToAgent::Unknown);
    assert_eq!(agent.hellos.len(), hellos + 1, "after an acknowledgement, a hello is sent without a pause");
}
