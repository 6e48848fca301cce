//! Tests with two ends of a connection, without topics between them.

use std::collections::VecDeque;

use peernet_ros::messages::{Header, Message, Time, WireForm};
use proptest::prelude::*;

use super::*;
use crate::transport::ros::frames;

const LIMITS: ConnectionLimits = ConnectionLimits {
    max_message_bytes: 1_000,
    confirms_payloads: false,
    max_incomplete: 4,
    pairing_timeout: Span::from_seconds(30),
    heartbeat_interval: Span::from_seconds(1),
    heartbeat_timeout: Span::from_seconds(5),
};

/// Departure of a notice on the wall clock. No test depends on it.
const NOTICE_WALL: i64 = 0;

fn new_connection() -> Connection {
    Connection::new("ab".into(), LIMITS, MemoryBudget::new(10_000), MonoTime::default())
}

fn time_at(seconds: i64) -> MonoTime {
    MonoTime::default() + Span::from_seconds(seconds)
}

/// Returns a message of three frames as it is sent: its companion and its payload.
fn message(sender: &mut Connection, request: u64, wall: i64) -> (MessageInfo, Bytes) {
    let mut info = MessageInfo { request, ..sender.new_companion(MessageInfo::DATA, wall, time_at(0)) };
    let payload = Bytes::from_static(b"payload");
    let frames = [Bytes::from_static(b"header"), Bytes::from_static(b"tree"), payload.clone()];
    let has_payload = true;
    assert!(frames::pack(&mut info, &frames, has_payload));
    (info, payload)
}

#[test]
fn sender_is_notified_of_missing_payload() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    let (lost_companion, _) = message(&mut sender, 7, 10);
    let (info, payload) = message(&mut sender, 8, 20);
    receiver.receive_companion(lost_companion, time_at(0));
    receiver.receive_companion(info.clone(), time_at(0));
    receiver.receive_payload(info.header.stamp.as_nanos(), payload, time_at(0));
    let Some(Event::IncomingLost(loss)) = receiver.next_event() else { panic!("the first message is lost") };
    assert_eq!(loss.tag, Some(7));
    let Some(Event::Message(frames, _)) = receiver.next_event() else {
        panic!("the second message is whole")
    };
    assert_eq!(frames.concat(), b"headertreepayload");
    let notice = receiver.next_notice(NOTICE_WALL, time_at(0)).expect("the sender is notified");
    sender.receive_companion(notice, time_at(0));
    let Some(Event::OutgoingLost(loss)) = sender.next_event() else {
        panic!("the sender is notified of the loss")
    };
    assert_eq!(loss.tag, Some(7));
}

#[test]
fn heartbeats_keep_connection_and_silence_ends_it() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    for second in 1..20 {
        let heartbeat =
            sender.next_notice(NOTICE_WALL, time_at(second)).expect("a heartbeat is due each second");
        receiver.receive_companion(heartbeat, time_at(second));
        receiver.tick(time_at(second));
        assert!(
            sender.next_notice(NOTICE_WALL, time_at(second)).is_none() && receiver.next_event().is_none()
        );
    }
    assert_eq!(receiver.missing_companions(), 0);
    receiver.tick(time_at(24));
    assert!(matches!(receiver.next_event(), Some(Event::Gone(_))) && receiver.next_timer().is_none());
}

#[test]
fn goodbye_ends_connection_with_its_reason() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    let goodbye = sender.new_companion(MessageInfo::GOODBYE, 0, time_at(0));
    receiver.receive_companion(MessageInfo { reason: "it\nshuts down".into(), ..goodbye }, time_at(0));
    assert!(matches!(receiver.next_event(), Some(Event::Gone(reason)) if reason == "it shuts down"));
    assert!(receiver.next_notice(NOTICE_WALL, time_at(100)).is_none());
}

#[test]
fn goodbye_waits_for_payload_that_it_overtook() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    let (info, payload) = message(&mut sender, 7, 10);
    let goodbye = sender.new_companion(MessageInfo::GOODBYE, 20, time_at(0));
    receiver.receive_companion(info.clone(), time_at(0));
    receiver.receive_companion(MessageInfo { reason: "done".into(), ..goodbye }, time_at(0));
    assert!(receiver.next_event().is_none() && receiver.peer().has_left);
    receiver.receive_payload(info.header.stamp.as_nanos(), payload, time_at(0));
    assert!(matches!(receiver.next_event(), Some(Event::Message(..))));
    assert!(matches!(receiver.next_event(), Some(Event::Gone(reason)) if reason == "done"));
}

#[test]
fn session_message_waits_for_payload_that_it_overtook() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    let (info, payload) = message(&mut sender, 7, 10);
    let mut session = sender.new_companion(MessageInfo::DATA, 20, time_at(0));
    let has_payload = false;
    assert!(frames::pack(&mut session, &[Bytes::from_static(b"close")], has_payload));
    receiver.receive_companion(info.clone(), time_at(0));
    receiver.receive_companion(session, time_at(0));
    assert!(receiver.next_event().is_none());
    receiver.receive_payload(info.header.stamp.as_nanos(), payload, time_at(0));
    assert!(matches!(receiver.next_event(), Some(Event::Message(frames, _)) if frames.concat() != b"close"));
    assert!(matches!(receiver.next_event(), Some(Event::Message(frames, _)) if frames.concat() == b"close"));
    assert!(receiver.next_event().is_none());
}

#[test]
fn goodbye_ends_connection_if_payload_never_arrives() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    let (info, _) = message(&mut sender, 7, 10);
    let goodbye = sender.new_companion(MessageInfo::GOODBYE, 20, time_at(0));
    receiver.receive_companion(info, time_at(0));
    receiver.receive_companion(MessageInfo { reason: "done".into(), ..goodbye }, time_at(0));
    receiver.tick(time_at(5));
    assert!(matches!(receiver.next_event(), Some(Event::Gone(reason)) if reason == "done"));
}

#[test]
fn payload_that_arrives_twice_is_delivered_once_and_confirmed() {
    let limits = ConnectionLimits { confirms_payloads: true, ..LIMITS };
    let confirming_connection =
        || Connection::new("ab".into(), limits, MemoryBudget::new(10_000), MonoTime::default());
    for is_payload_first in [true, false] {
        let (mut sender, mut receiver) = (confirming_connection(), confirming_connection());
        let mut info = MessageInfo { request: 7, ..sender.new_companion(MessageInfo::DATA, 10, time_at(0)) };
        let payload = Bytes::from_static(b"payload");
        let frames = [Bytes::from_static(b"header"), Bytes::from_static(b"tree"), payload.clone()];
        // The payload arrives in the companion and on the payload topic.
        let has_payload = false;
        assert!(frames::pack(&mut info, &frames, has_payload));
        let stamp = info.header.stamp.as_nanos();
        if is_payload_first {
            receiver.receive_payload(stamp, payload, time_at(0));
            receiver.receive_companion(info, time_at(0));
        } else {
            receiver.receive_companion(info, time_at(0));
            receiver.receive_payload(stamp, payload, time_at(0));
        }
        assert!(
            matches!(receiver.next_event(), Some(Event::Message(frames, _)) if frames.concat() == b"headertreepayload")
        );
        assert!(receiver.next_event().is_none());
        sender.receive_companion(
            receiver.next_notice(NOTICE_WALL, time_at(0)).expect("a confirmation"),
            time_at(0),
        );
        assert!(sender.peer().is_subscribed && receiver.next_notice(NOTICE_WALL, time_at(0)).is_none());
        receiver.tick(time_at(4));
        assert!(receiver.next_event().is_none(), "no companion and no payload is awaited");
    }
}

#[test]
fn fragments_are_assembled_and_unfinished_messages_dropped() {
    let (mut sender, mut receiver) = (new_connection(), new_connection());
    for is_whole in [false, true] {
        let (mut info, payload) = message(&mut sender, 7, 10);
        let stamp = info.header.stamp.as_nanos();
        let fragments = crate::transport::ros::fragments::split_into_fragments(&mut info.frames, 4);
        let companions: Vec<MessageInfo> = fragments
            .into_iter()
            .map(|frames| MessageInfo { frames, ..sender.new_fragment(&mut info) })
            .collect();
        assert_eq!(companions.len(), 2);
        companions.into_iter().for_each(|companion| receiver.receive_companion(companion, time_at(0)));
        if is_whole {
            receiver.receive_companion(info, time_at(0));
            receiver.receive_payload(stamp, payload, time_at(0));
        }
    }
    assert!(
        matches!(receiver.next_event(), Some(Event::Message(frames, _)) if frames.concat() == b"headertreepayload")
    );
    assert_eq!(
        (receiver.next_event().is_none(), receiver.missing_companions()),
        (true, 1),
        "the last companion of the first message never arrived"
    );
}

#[test]
fn message_whose_fragments_exceed_budget_is_lost_and_peer_is_notified() {
    // The first fragment fits into the memory, and the second does not.
    let (mut sender, budget) = (new_connection(), MemoryBudget::new(5));
    let mut receiver = Connection::new("ab".into(), LIMITS, Arc::clone(&budget), MonoTime::default());
    let (mut info, _) = message(&mut sender, 7, 10);
    for frames in crate::transport::ros::fragments::split_into_fragments(&mut info.frames, 4) {
        let fragment = MessageInfo { frames, ..sender.new_fragment(&mut info) };
        receiver.receive_companion(fragment, time_at(0));
    }
    receiver.receive_companion(info, time_at(0));
    let event = receiver.next_event();
    assert!(matches!(&event, Some(Event::IncomingLost(loss)) if loss.tag == Some(7)), "{event:?}");
    let notice = receiver.next_notice(NOTICE_WALL, time_at(0)).expect("the sender is notified");
    assert_eq!((notice.kind, notice.request), (MessageInfo::LOST, 7));
    assert_eq!(budget.reserved_bytes(), 0);
}

/// Input from a peer that violates the protocol.
#[derive(Clone, Debug)]
enum Step {
    /// A companion with some bytes changed.
    Damaged {
        form: WireForm,
        kind: u8,
        changes: Vec<(prop::sample::Index, u8)>,
    },
    /// A companion with arbitrary fields.
    Claims {
        kind: u8,
        sequence: u64,
        stamp: i64,
        has_payload: bool,
        lengths: Vec<u32>,
        bytes: usize,
    },
    Payload {
        stamp: i64,
        bytes: usize,
    },
    /// Seconds that pass.
    Time(i64),
}

fn any_step() -> impl Strategy<Value = Step> {
    // All kinds, and an unknown kind.
    let kind = || 0..=MessageInfo::PART + 1;
    let form = prop::sample::select(vec![WireForm::Ros1, WireForm::Cdr]);
    // There are few stamps, so some coincide.
    let stamp = || prop_oneof![9 => 0..4_i64, 1 => any::<i64>()];
    let length = prop_oneof![3 => 0..40_u32, 1 => any::<u32>()];
    let claims =
        (kind(), any::<u64>(), stamp(), any::<bool>(), prop::collection::vec(length, 0..5), 0..60_usize);
    prop_oneof![
        (form, kind(), prop::collection::vec(any::<(prop::sample::Index, u8)>(), 0..4))
            .prop_map(|(form, kind, changes)| Step::Damaged { form, kind, changes }),
        claims.prop_map(|(kind, sequence, stamp, has_payload, lengths, bytes)| {
            Step::Claims { kind, sequence, stamp, has_payload, lengths, bytes }
        }),
        (stamp(), 0..2_000_usize).prop_map(|(stamp, bytes)| Step::Payload { stamp, bytes }),
        (0..3_i64).prop_map(Step::Time),
    ]
}

fn apply_step(step: Step, sender: &mut Connection, receiver: &mut Connection, now: &mut MonoTime) {
    match step {
        Step::Damaged { form, kind, changes } => {
            let (info, _) = message(sender, 1, 0);
            let info = MessageInfo { kind, ..info };
            let mut bytes = info.encode(form).expect("the companion is short").into_bytes().to_vec();
            for (index, byte) in changes {
                let index = index.index(bytes.len());
                bytes[index] = byte;
            }
            if let Ok(info) = MessageInfo::decode(form, bytes.into()) {
                receiver.receive_companion(info, *now);
            }
        }
        Step::Claims { kind, sequence, stamp, has_payload, lengths, bytes } => {
            let header = Header { seq: 0, stamp: Time::from_nanos(stamp), frame_id: "ab".into() };
            let (frames, frame_lengths) = (vec![7; bytes].into(), lengths);
            let info = MessageInfo {
                header,
                kind,
                sequence,
                has_payload,
                frame_lengths,
                frames,
                ..MessageInfo::default()
            };
            receiver.receive_companion(info, *now);
        }
        Step::Payload { stamp, bytes } => receiver.receive_payload(stamp, vec![7; bytes].into(), *now),
        Step::Time(seconds) => *now = *now + Span::from_seconds(seconds),
    }
}

#[derive(Clone, Debug)]
enum Fate {
    Arrives,
    LosesPayload,
    LosesCompanion,
}

proptest! {
    #[test]
    fn every_message_arrives_once_or_is_lost(
        fates in proptest::collection::vec(
            prop_oneof![
                5 => Just(Fate::Arrives),
                1 => Just(Fate::LosesPayload),
                1 => Just(Fate::LosesCompanion),
            ],
            0..40,
        ),
        lag in 0_usize..3,
    ) {
        let budget = MemoryBudget::new(10_000);
        let mut sender = new_connection();
        let mut receiver = Connection::new("ab".into(), LIMITS, Arc::clone(&budget), MonoTime::default());
        let (mut companions, mut payloads) = (VecDeque::new(), VecDeque::new());
        for (request, fate) in fates.iter().enumerate() {
            let (info, payload) = message(&mut sender, request as u64, 0);
            let stamp = info.header.stamp.as_nanos();
            companions.push_back((!matches!(fate, Fate::LosesCompanion)).then_some(info));
            payloads.push_back((!matches!(fate, Fate::LosesPayload)).then_some((stamp, payload)));
        }
        // Payloads arrive some messages after their companions.
        let mut remaining_lag = lag;
        while !companions.is_empty() || !payloads.is_empty() {
            if let Some(Some(info)) = companions.pop_front() {
                receiver.receive_companion(info, time_at(0));
            }
            if remaining_lag > 0 && !companions.is_empty() {
                remaining_lag -= 1;
            } else if let Some(Some((stamp, payload))) = payloads.pop_front() {
                receiver.receive_payload(stamp, payload, time_at(0));
            }
        }
        // After 40 s the time limit of all companions and payloads that wait for each other has passed. The heartbeat
        // timeout must not end the connection before that.
        receiver.heartbeats.note_received(time_at(40));
        receiver.tick(time_at(40));
        let (mut arrived, mut incomplete) = (0, 0);
        while let Some(event) = receiver.next_event() {
            match event {
                Event::Message(..) => arrived += 1,
                Event::IncomingLost(_) => incomplete += 1,
                other => prop_assert!(false, "{other:?}"),
            }
        }
        let complete_count = fates.iter().filter(|fate| matches!(fate, Fate::Arrives)).count();
        prop_assert_eq!((arrived, arrived + incomplete), (complete_count, fates.len()));
        prop_assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn any_peer_messages_need_bounded_memory(
        confirms_payloads: bool,
        steps in prop::collection::vec(any_step(), 0..30),
    ) {
        let limits = ConnectionLimits { confirms_payloads, ..LIMITS };
        let budgets = [(); 2].map(|()| MemoryBudget::new(10_000));
        let [mut sender, mut receiver] =
            budgets.each_ref().map(|budget| Connection::new("ab".into(), limits, Arc::clone(budget), time_at(0)));
        let ([_, budget], mut now) = (budgets, time_at(0));
        for step in steps {
            apply_step(step, &mut sender, &mut receiver, &mut now);
            receiver.tick(now);
            prop_assert!(budget.reserved_bytes() <= 10_000);
            let mut events = 0;
            while let Some(event) = receiver.next_event() {
                events += 1;
                let Event::Message(frames, _) = event else { continue };
                let bytes: usize = frames.iter().map(Bytes::len).sum();
                prop_assert!(bytes as u64 <= LIMITS.max_message_bytes, "{bytes} bytes");
            }
            // One step may give up all incomplete messages: companions that wait for their payload, and payloads that
            // wait for their companion. It causes few other events: it may deliver a message and end the connection.
            prop_assert!(events <= LIMITS.max_incomplete + 3, "{events} events of one step");
            while receiver.next_notice(NOTICE_WALL, now).is_some() {}
        }
        receiver.tick(now + Span::from_seconds(40));
        prop_assert_eq!(budget.reserved_bytes(), 0, "nothing waits for ever");
    }
}
