//! Tests of pairing: each message is resolved once, no matter in which order the messages arrive.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::*;

const TIMEOUT: Span = Span::from_millis(100);
const CAPACITY: usize = 4;

type NumberedResolution = Resolution<u32, u32>;

fn at(millis: i64) -> MonoTime {
    MonoTime::from_nanos(millis * 1_000_000)
}

fn pairing() -> Pairing<u32, u32> {
    Pairing::new(TIMEOUT, CAPACITY)
}

fn paired(input: u32, output: u32) -> Option<NumberedResolution> {
    Some(Resolution::Paired { input, output })
}

#[test]
fn equal_keys_are_paired_in_any_order_of_arrival() {
    let mut pairing = pairing();
    assert_eq!(pairing.add_input(Some(10), at(0), 1), None);
    assert_eq!(pairing.add_input(Some(20), at(1), 2), None);
    assert_eq!(pairing.add_output(Some(20), at(2), 12), paired(2, 12));
    assert_eq!(pairing.add_output(Some(30), at(3), 13), None, "the input message may still arrive");
    assert_eq!(pairing.add_input(Some(30), at(4), 3), paired(3, 13));
    assert_eq!(pairing.add_output(Some(10), at(5), 11), paired(1, 11));
    assert!(pairing.has_no_unpaired_inputs());
}

#[test]
fn second_output_of_one_input_is_unmatched() {
    let mut pairing = pairing();
    pairing.add_input(Some(10), at(0), 1);
    assert_eq!(pairing.add_output(Some(10), at(1), 11), paired(1, 11));
    assert_eq!(pairing.add_output(Some(10), at(2), 12), None);
    assert_eq!(pairing.expire(at(101)), None);
    assert_eq!(pairing.expire(at(102)), Some(Resolution::Unmatched(12)));
}

#[test]
fn input_without_output_is_given_up_at_its_deadline() {
    let mut pairing = pairing();
    pairing.add_input(Some(10), at(5), 1);
    assert_eq!(pairing.next_deadline(), Some(at(105)));
    assert_eq!(pairing.expire(at(104)), None);
    let expired = Resolution::Unanswered { input: 1, cause: UnansweredCause::Expired };
    assert_eq!(pairing.expire(at(105)), Some(expired));
    assert_eq!((pairing.expire(at(105)), pairing.next_deadline()), (None, None));
}

#[test]
fn pairing_by_order_takes_oldest_input_before_output() {
    let mut pairing = pairing();
    assert_eq!(pairing.add_output(None, at(0), 10), Some(Resolution::Unmatched(10)));
    pairing.add_input(None, at(1), 1);
    pairing.add_input(None, at(2), 2);
    assert_eq!(pairing.add_output(None, at(3), 11), paired(1, 11));
    // This output message is handled late: the agent received it before the waiting input message.
    assert_eq!(pairing.add_output(None, at(1), 12), Some(Resolution::Unmatched(12)));
    assert_eq!(pairing.add_output(None, at(4), 13), paired(2, 13));
}

/// A message of a topic, with its key, or a check for expired messages.
#[derive(Clone, Copy, Debug)]
enum TopicEvent {
    Input(Option<i64>),
    Output(Option<i64>),
    Expire,
}

fn topic_events() -> impl Strategy<Value = Vec<(i64, TopicEvent)>> {
    let by_key = prop_oneof![
        4 => (0_i64..6).prop_map(|key| TopicEvent::Input(Some(key))),
        4 => (0_i64..6).prop_map(|key| TopicEvent::Output(Some(key))),
        2 => Just(TopicEvent::Expire),
    ];
    let by_order = prop_oneof![
        4 => Just(TopicEvent::Input(None)),
        4 => Just(TopicEvent::Output(None)),
        2 => Just(TopicEvent::Expire),
    ];
    let step = 0_i64..40;
    prop_oneof![
        proptest::collection::vec((step.clone(), by_key), 0..200),
        proptest::collection::vec((step, by_order), 0..200),
    ]
}

/// Keys and reception times of the messages of a topic that are not resolved yet, by number.
type WaitingMessages = BTreeMap<u32, (Option<i64>, MonoTime)>;

/// Removes the messages of a resolution from the waiting messages, and checks that the resolution is allowed.
fn settle(
    resolution: &NumberedResolution,
    now: MonoTime,
    inputs: &mut WaitingMessages,
    outputs: &mut WaitingMessages,
) -> Result<(), TestCaseError> {
    match resolution {
        Resolution::Paired { input, output } => {
            let (input, output) = (inputs.remove(input), outputs.remove(output));
            let (Some((key, received_at)), Some((output_key, output_received_at))) = (input, output) else {
                return Err(TestCaseError::fail("a message was resolved twice"));
            };
            prop_assert_eq!(key, output_key);
            prop_assert!(key.is_some() || received_at <= output_received_at);
        }
        Resolution::Unanswered { input, cause } => {
            let waited = inputs.remove(input).map(|(_, received_at)| now - received_at);
            let Some(waited) = waited else { return Err(TestCaseError::fail("an input was resolved twice")) };
            match cause {
                UnansweredCause::Expired => prop_assert!(waited >= TIMEOUT),
                UnansweredCause::Displaced => prop_assert!(inputs.len() >= CAPACITY),
            }
        }
        Resolution::Unmatched(output) => {
            prop_assert!(outputs.remove(output).is_some(), "an output was resolved twice");
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn every_message_is_resolved_once_in_bounded_memory(topic_events in topic_events()) {
        let (mut pairing, mut now, mut number) = (pairing(), at(0), 0_u32);
        let (mut inputs, mut outputs) = (WaitingMessages::new(), WaitingMessages::new());
        for (pause, topic_event) in topic_events {
            now = now + Span::from_millis(pause);
            number += 1;
            let resolution = match topic_event {
                TopicEvent::Input(key) => {
                    inputs.insert(number, (key, now));
                    pairing.add_input(key, now, number)
                }
                TopicEvent::Output(key) => {
                    outputs.insert(number, (key, now));
                    pairing.add_output(key, now, number)
                }
                TopicEvent::Expire => None,
            };
            if let Some(resolution) = resolution {
                settle(&resolution, now, &mut inputs, &mut outputs)?;
            }
            if matches!(topic_event, TopicEvent::Expire) {
                while let Some(resolution) = pairing.expire(now) {
                    settle(&resolution, now, &mut inputs, &mut outputs)?;
                }
                prop_assert!(pairing.next_deadline().is_none_or(|deadline| deadline > now));
            }
            // No message is lost, and at most `CAPACITY` messages of each topic wait.
            prop_assert!(inputs.len() <= CAPACITY && outputs.len() <= CAPACITY);
            prop_assert_eq!(pairing.inputs.len(), inputs.len());
            prop_assert_eq!(pairing.outputs.len(), outputs.len());
            prop_assert_eq!(pairing.has_no_unpaired_inputs(), inputs.is_empty());
            // Messages that could be paired do not wait.
            let waiting_keys: BTreeSet<i64> = inputs.values().filter_map(|(key, _)| *key).collect();
            prop_assert!(outputs.values().all(|(key, _)| key.is_some_and(|key| !waiting_keys.contains(&key))));
        }
        let unpaired_inputs: Vec<u32> = pairing.take_unpaired_inputs().collect();
        prop_assert_eq!(unpaired_inputs, inputs.keys().copied().collect::<Vec<_>>());
    }

    #[test]
    fn pairs_by_order_keep_sequence_of_both_topics(is_input in proptest::collection::vec(any::<bool>(), 0..100)) {
        let mut pairing = pairing();
        let mut pairs = Vec::new();
        for (number, is_input) in (0_u32..).zip(is_input) {
            let resolution = if is_input {
                pairing.add_input(None, at(number.into()), number)
            } else {
                pairing.add_output(None, at(number.into()), number)
            };
            if let Some(Resolution::Paired { input, output }) = resolution {
                pairs.push((input, output));
            }
        }
        prop_assert!(pairs.is_sorted_by(|pair, next| pair.0 < next.0 && pair.1 < next.1));
    }
}
