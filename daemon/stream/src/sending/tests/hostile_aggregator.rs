//! An aggregator that sends wrong messages: the agent never panics, and no event is dropped or waits for ever.

use proptest::prelude::*;

use super::*;

#[test]
fn acknowledgement_of_unsent_batch_causes_new_hello() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(5);
    assert_eq!(agent.take_sent_numbers(), [1, 2, 3]);
    for through in [4, 5, 6, u64::MAX] {
        agent.ack(through);
        assert_eq!((agent.file.batches.len(), agent.accounting().stored), (5, 0));
        agent.advance_ms(60_000);
        agent.welcome(0, None);
    }
    assert_eq!(agent.take_sent_numbers().last(), Some(&3));
}

#[test]
fn batches_are_sent_again_after_late_refusal() {
    let mut agent = Agent::new_welcomed(config());
    agent.offer_batches(5);
    assert_eq!(agent.take_sent_numbers(), [1, 2, 3], "the window is full");
    agent.receive(&ToAgent::Refused { reason: "no".into() });
    // The next hello follows after a pause of one second.
    agent.advance_ms(1_000);
    agent.welcome(0, None);
    assert_eq!(agent.deliver(), [1, 2, 3, 4, 5]);
    assert!(agent.sending.is_idle());
}

fn message(stream: StreamId, kind: u8, number: u64, window: u32, chain: Option<ChainHash>) -> ToAgent {
    match kind {
        0 | 1 => {
            let aggregator = "base".parse().expect("a name");
            ToAgent::Welcome { aggregator, stream, stored: number, chain, process: Some(number & 3), window }
        }
        2 | 3 => ToAgent::Ack { stream, through: number, window },
        4 => ToAgent::Resend { stream, from: number },
        5 => ToAgent::Refused { reason: "no".into() },
        _ => ToAgent::Unknown,
    }
}

proptest! {
    #[test]
    fn arbitrary_messages_cause_no_panic_and_drop_no_event(
        steps in prop::collection::vec((0_u8..11, prop_oneof![0_u64..14, Just(u64::MAX)], any::<u32>(), 0_u8..4), 1..60),
    ) {
        let mut agent = Agent::new(SendingConfig { batch_bytes: 200, ..config() });
        agent.offer_batches(8);
        let mut agent = agent.restart();
        agent.connect();
        for (kind, number, window, flags) in steps {
            agent.spool_is_broken = flags == 3;
            match kind {
                7 => agent.offer_batches(1),
                8 => agent.advance_ms(1_000),
                9 => { agent.sending.on_disconnected(); agent.settle(); agent.connect(); }
                10 => { agent.spool_is_broken = false; agent = agent.restart(); agent.connect(); }
                _ => {
                    let stream = if flags == 0 { StreamId::random() } else { agent.stream() };
                    let chain = match flags { 1 => agent.chain(number), 2 => Some(ChainHash::START), _ => None };
                    agent.receive(&message(stream, kind, number, window, chain));
                }
            }
        }
        // An aggregator that behaves correctly then receives all remaining batches.
        agent.spool_is_broken = false;
        agent.sending.on_disconnected();
        for _ in 0..10 {
            agent.advance_ms(20_000);
            agent.connect();
            let hello = agent.hellos.last().expect("a hello").clone();
            agent.welcome(hello.oldest - 1, (hello.oldest > hello.first).then_some(hello.chain_before_oldest));
            agent.deliver();
        }
        prop_assert!(agent.sending.is_idle(), "{:?}", agent.sending);
        prop_assert_eq!(agent.accounting().dropped, 0);
    }
}
