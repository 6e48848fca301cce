//! Tests of the sender's state machine.

mod clocks;

use std::net::SocketAddr;
use std::sync::Arc;

use peernet_clock::{
    Clock, ClockIdentity, ExchangeObservation, ManualClock, MonoTime, RawTime, RelatedClocks, Span, WallTime,
};
use peernet_probes::stamp::auth::Key;
use peernet_probes::stamp::packet::{self, Mode, Reply};
use peernet_probes::stamp::reflector::{Arrival, ReflectorState};
use peernet_probes::stamp::sender::{
    Departure, LATE_REPLY, ReplyArrival, ReplyResult, SenderConfig, SenderState,
};
use peernet_probes::stamp::tlv::{self, Origin, RawStamps};
use peernet_probes::stamp::uncertainty;

use crate::support::{INSTANCE, key};

const TIMEOUT: Span = Span::from_seconds(1);
const ONE_WAY_DELAY: Span = Span::from_micros(700);

fn config() -> SenderConfig {
    SenderConfig {
        key: None,
        instance: None,
        with_nonce: false,
        clocks: RelatedClocks::RawToWall,
        ssid: 1,
        first_sequence: 0,
        padding_bytes: 0,
        timeout: TIMEOUT,
    }
}

/// A sender and a reflector that are connected directly, with the clocks of two hosts. The reflector's wall clock is
/// ahead by a second, and its free-running clock shows the same time as the sender's.
struct Pair {
    clock: Arc<ManualClock>,
    sender: SenderState,
    reflector: ReflectorState,
    ahead: Span,
}

impl Pair {
    fn new(key: Option<Key>) -> Self {
        let (max_per_source_hz, stateful) = (1_000_000, true);
        let start = WallTime::from_unix_nanos(1_800_000_000_123_456_789);
        Self {
            clock: Arc::new(ManualClock::new(start, ClockIdentity::new("b", "c"))),
            sender: SenderState::new(SenderConfig { key: key.clone(), ssid: 99, ..config() }),
            reflector: ReflectorState::new(key, INSTANCE, max_per_source_hz, stateful),
            ahead: Span::from_seconds(1),
        }
    }

    /// Returns a pair whose first probe has this sequence number.
    fn with_first_sequence(first_sequence: u32) -> Self {
        let mut pair = Self::new(None);
        pair.sender = SenderState::new(SenderConfig { ssid: 99, first_sequence, ..config() });
        pair
    }

    /// Returns a pair whose exchanges contain stamps of the free-running clocks.
    fn raw(key: Option<Key>) -> Self {
        let mut pair = Self::new(key.clone());
        pair.sender =
            SenderState::new(SenderConfig { key, ssid: 99, clocks: RelatedClocks::Raw, ..config() });
        pair
    }

    /// Returns the reflector's clocks at the present time.
    fn reflector_clocks(&self) -> ManualClock {
        let elapsed = self.clock.raw() - ManualClock::FIRST_RAW;
        let reflector_clocks =
            ManualClock::new(self.clock.wall() + self.ahead - elapsed, ClockIdentity::new("b", "d"));
        reflector_clocks.advance(elapsed);
        reflector_clocks
    }

    fn reply_arrival(&self, kernel: Option<WallTime>) -> ReplyArrival {
        let (ahead, epoch) = (self.clock.wall_ahead(), self.clock.epoch());
        ReplyArrival { kernel, read: self.clock.stamp(), ahead, epoch }
    }

    fn send(&mut self) -> (Departure, Vec<u8>) {
        let (departure, packet) = self.sender.request(&*self.clock);
        let packet = packet.to_vec();
        assert_eq!(self.sender.record_sent(departure), 0);
        (departure, packet)
    }

    fn reflect(&mut self, mut packet: Vec<u8>) -> Vec<u8> {
        self.clock.advance(ONE_WAY_DELAY);
        let reflector_clocks = self.reflector_clocks();
        let source: SocketAddr = "10.0.0.1:40000".parse().expect("an address");
        let (received, received_raw) = (reflector_clocks.wall(), reflector_clocks.raw());
        let arrival = Arrival { source, received, received_raw, now: self.clock.mono() };
        let answer = self.reflector.prepare(&mut packet, &arrival).expect("answered");
        reflector_clocks.advance(Span::from_micros(50));
        let stamp = self.reflector.complete(&answer, &mut packet, &reflector_clocks);
        self.reflector.record_sent(&answer, stamp);
        let departed_at = stamp + Span::from_micros(5);
        self.reflector.record_departure(
            &answer.session(),
            answer.sequence(),
            departed_at.wall,
            departed_at.raw,
        );
        self.clock.advance(Span::from_micros(55) + ONE_WAY_DELAY);
        packet
    }

    fn receive_reply(&mut self, packet: &[u8]) -> Result<ReplyResult, &'static str> {
        let arrival = self.reply_arrival(None);
        self.sender.receive(packet, &arrival)
    }

    fn exchange(&mut self) -> ReplyResult {
        let (_, packet) = self.send();
        let reply = self.reflect(packet);
        self.receive_reply(&reply).expect("an answer")
    }

    /// Returns the next answer. The kernel stamped its arrival when the program's clock showed `kernel`.
    fn exchange_with_kernel_stamp(&mut self, kernel: WallTime) -> ExchangeObservation {
        let (departure, packet) = self.send();
        self.sender.record_departure(departure.sequence(), self.clock.wall(), self.clock.wall_ahead());
        let reply = self.reflect(packet);
        let arrival = self.reply_arrival(Some(kernel));
        answered(&self.sender.receive(&reply, &arrival).expect("an answer"))
    }
}

fn answered(reply_result: &ReplyResult) -> ExchangeObservation {
    reply_result.answered.expect("no step")
}

impl Pair {
    /// Returns the reply with another origin.
    fn with_origin(reply: &[u8], change: impl Fn(&mut Origin)) -> Vec<u8> {
        let mut reply = reply.to_vec();
        let header =
            tlv::headers(&reply[44..]).find(|header| header.kind == tlv::ORIGIN).expect("we ask for it");
        let mut origin = Origin::from_value(&reply[44..][header.value.clone()]).expect("a value of PEERNet");
        change(&mut origin);
        reply[44..][header.value].copy_from_slice(&origin.to_value());
        reply
    }
}

#[test]
fn next_reply_refines_departure_of_previous_reply() {
    for key in [None, Some(key(7))] {
        let mut pair = Pair::new(key);
        let started_at = pair.clock.stamp();
        let first = pair.exchange();
        let ExchangeObservation { exchange, cloud_elapsed, edge_epoch, cloud_epoch } = answered(&first);
        assert_eq!(first.refined, None);
        assert_eq!(exchange.sent, started_at.raw);
        assert_eq!(exchange.received, RawTime::from_wall(started_at.wall + ONE_WAY_DELAY + pair.ahead));
        assert_eq!(exchange.replied, exchange.received + Span::from_micros(50));
        assert_eq!(exchange.returned, pair.clock.raw());
        assert_eq!(exchange.uncertainty, uncertainty::PEERNET_ENDS);
        assert_eq!((cloud_elapsed, edge_epoch, cloud_epoch), (None, 0, Some(0)));

        let second = pair.exchange();
        let refined = second.refined.expect("the follow-up");
        assert_eq!(refined.exchange.replied, exchange.replied + Span::from_micros(5));
        assert_eq!((refined.exchange.sent, refined.exchange.received), (exchange.sent, exchange.received));
        assert_eq!(
            refined.exchange.round_trip(),
            ONE_WAY_DELAY + ONE_WAY_DELAY,
            "the delay of the reflector is subtracted"
        );
    }
}

#[test]
fn plausible_kernel_departure_stamp_is_used() {
    for (delay, is_used) in
        [(Span::from_micros(9), true), (-Span::from_nanos(1), false), (Span::from_seconds(2), false)]
    {
        let mut pair = Pair::new(None);
        let started_at = pair.clock.stamp();
        let (departure, packet) = pair.send();
        pair.sender.record_departure(departure.sequence(), started_at.wall + delay, pair.clock.wall_ahead());
        let reply = pair.reflect(packet);
        let answered = answered(&pair.receive_reply(&reply).expect("an answer"));
        assert_eq!(answered.exchange.sent, if is_used { started_at.raw + delay } else { started_at.raw });
    }
}

#[test]
fn sequence_numbers_wrap_around() {
    let mut pair = Pair::with_first_sequence(u32::MAX - 2);
    let sent: Vec<_> = (0..6).map(|_| pair.send()).collect();
    assert_eq!(sent.last().map(|(departure, _)| departure.sequence()), Some(2));
    for (_, packet) in sent.into_iter().rev() {
        let reply = pair.reflect(packet);
        pair.receive_reply(&reply).expect("an answer in any order");
    }
    assert_eq!(pair.sender.expire(pair.clock.mono() + TIMEOUT), 0);
}

#[test]
fn late_replies_are_lost_and_duplicates_count_once() {
    let mut pair = Pair::new(None);
    let (_, late_packet) = pair.send();
    let deadline = pair.sender.deadline().expect("a probe waits for its answer");
    assert_eq!(deadline, pair.clock.mono() + TIMEOUT);
    let reply_result = pair.exchange();
    assert!(answered(&reply_result).exchange.sent < pair.clock.raw());
    pair.clock.advance(TIMEOUT - Span::from_millis(900));
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    pair.receive_reply(&reply).expect("an answer");
    assert_eq!(pair.receive_reply(&reply), Err("a second answer to the same probe"));

    pair.clock.advance(TIMEOUT - Span::from_millis(100));
    assert_eq!(pair.sender.expire(pair.clock.mono()), 1, "one of the two old probes was answered");
    assert_eq!(pair.sender.expire(pair.clock.mono()), 0, "counted once");
    assert_eq!(pair.sender.deadline(), None);
    let reply = pair.reflect(late_packet);
    let mut forged = reply.clone();
    let mut fields = Reply::parse(Mode::Unauthenticated, &forged).expect("a reply");
    fields.request.timestamp += 1;
    fields.write(Mode::Unauthenticated, &mut forged);
    assert_eq!(pair.receive_reply(&forged), Err("an answer with another stamp than its probe"));
    assert_eq!(pair.receive_reply(&reply), Err(LATE_REPLY));
    assert_eq!(
        pair.receive_reply(&reply),
        Err("an answer to an unknown or forgotten probe"),
        "a late answer counts once"
    );
}

#[test]
fn reply_with_wrong_request_fields_is_refused() {
    let mut pair = Pair::new(None);
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    let mut forge = |change: fn(&mut Reply)| {
        let mut forged = reply.clone();
        let mut fields = Reply::parse(Mode::Unauthenticated, &forged).expect("a reply");
        change(&mut fields);
        fields.write(Mode::Unauthenticated, &mut forged);
        pair.receive_reply(&forged)
    };
    assert_eq!(forge(|reply| reply.request.ssid = 98), Err("an answer of another session"));
    assert_eq!(forge(|reply| reply.request.sequence += 1), Err("an answer to an unknown or forgotten probe"));
    assert_eq!(
        forge(|reply| reply.request.timestamp ^= 1),
        Err("an answer with another stamp than its probe")
    );
    assert_eq!(forge(|reply| reply.received = 0), Err("an answer without the reflector's stamps"));
    assert!(forge(|reply| reply.request.ssid = 0).is_ok(), "reflectors without session identifiers write 0");
}

#[test]
fn altered_reply_is_refused_and_altered_tlvs_ignored() {
    let mut pair = Pair::new(Some(key(7)));
    pair.exchange();
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    for index in [0, 30, 50, 111] {
        let mut altered_reply = reply.clone();
        altered_reply[index] ^= 4;
        assert_eq!(pair.receive_reply(&altered_reply), Err("not authenticated by the key"));
    }
    let mut altered_reply = reply;
    *altered_reply.last_mut().expect("not empty") ^= 1;
    let reply_result = pair.receive_reply(&altered_reply).expect("the base packet is authentic");
    assert_eq!((reply_result.refined, answered(&reply_result).cloud_epoch), (None, None));
    assert_eq!(answered(&reply_result).exchange.uncertainty, uncertainty::OTHER_IMPLEMENTATION);
}

#[test]
fn tlvs_of_another_probe_are_refused() {
    let pair_with_nonce = |ssid| {
        let mut pair = Pair::raw(Some(key(7)));
        let clocks = RelatedClocks::Raw;
        let (key, instance) = (Some(key(7)), Some(INSTANCE));
        pair.sender =
            SenderState::new(SenderConfig { key, instance, with_nonce: true, ssid, clocks, ..config() });
        pair
    };
    let mut earlier_pair = pair_with_nonce(1);
    let (_, packet) = earlier_pair.send();
    let earlier_reply = earlier_pair.reflect(packet);
    let mut pair = pair_with_nonce(2);
    pair.clock.advance(Span::from_seconds(9));
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    // The base packet and the TLVs are each authentic by themselves. The TLVs belong to the earlier probe.
    let spliced_reply = [&reply[..112], &earlier_reply[112..]].concat();
    assert_eq!(pair.receive_reply(&spliced_reply), Err("an answer with the random octets of another probe"));
    // The octets are right, but in a place that is not authenticated.
    let nonce = tlv::headers(&reply[112..])
        .find(|header| header.kind == tlv::EXTRA_PADDING)
        .expect("the request has octets");
    let mut reply_with_appended_nonce = spliced_reply;
    tlv::push(&mut reply_with_appended_nonce, tlv::EXTRA_PADDING, &reply[112..][nonce.value]);
    assert_eq!(
        pair.receive_reply(&reply_with_appended_nonce),
        Err("an answer with the random octets of another probe")
    );
    let exchange = answered(&pair.receive_reply(&reply).expect("the reply to this probe")).exchange;
    assert_eq!(exchange.received - exchange.sent, ONE_WAY_DELAY);
}

#[test]
fn reply_of_reflector_without_tlvs_is_accepted() {
    let mut pair = Pair::new(None);
    for is_truncated in [false, true] {
        let (_, packet) = pair.send();
        let mut reply = pair.reflect(packet.clone());
        if is_truncated {
            reply.truncate(44);
        } else {
            // The reflector returns the TLVs unchanged.
            reply[44..].copy_from_slice(&packet[44..]);
        }
        let answered = answered(&pair.receive_reply(&reply).expect("an answer"));
        assert_eq!(
            (answered.cloud_epoch, answered.exchange.uncertainty),
            (None, uncertainty::OTHER_IMPLEMENTATION)
        );
    }
}

#[test]
fn clock_step_at_reflector_prevents_refinement() {
    let mut pair = Pair::new(None);
    pair.exchange();
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    // The epoch changes as if the reflector had noticed a step between the two replies.
    let reply = Pair::with_origin(&reply, |origin| origin.epoch = 1);
    let reply_result = pair.receive_reply(&reply).expect("an answer");
    assert_eq!((reply_result.refined, answered(&reply_result).cloud_epoch), (None, Some(1)));
}

#[test]
fn remembered_probes_are_bounded() {
    let mut pair = Pair::new(None);
    let mut dropped = 0;
    for _ in 0..5000 {
        let (departure, _) = pair.sender.request(&*pair.clock);
        dropped += pair.sender.record_sent(departure);
    }
    let lost = pair.sender.expire(MonoTime::from_nanos(i64::MAX));
    assert_eq!(dropped + lost, 5000, "each is lost once");
    assert!(lost <= 1024, "at most 1024 probes are remembered: {lost}");
}

#[test]
fn requests_are_authentic_and_padded_as_configured() {
    let clock = ManualClock::new(WallTime::from_unix_nanos(1), ClockIdentity::new("b", "c"));
    let mut sender = SenderState::new(SenderConfig {
        key: Some(key(7)),
        first_sequence: 5,
        padding_bytes: 100,
        ..config()
    });
    let (departure, packet) = sender.request(&clock);
    assert_eq!(departure.sequence(), 5);
    assert!(packet::is_authentic(&key(7), packet));
    assert!(tlv::are_intact(Some(&key(7)), 5, &packet[112..]));
    // Base packet, follow-up, origin, HMAC and padding; each TLV has a header of four bytes.
    assert_eq!(packet.len(), 112 + 20 + 20 + 20 + 104);
    let mut sender = SenderState::new(config());
    let (_, packet) = sender.request(&clock);
    assert_eq!(packet.len(), 44 + 20 + 20);
    let mut sender = SenderState::new(SenderConfig { clocks: RelatedClocks::Raw, ..config() });
    let (_, packet) = sender.request(&clock);
    // The stamps of the free-running clock are added.
    assert_eq!(packet.len(), 44 + 20 + 20 + 40);
}

#[test]
fn exchanges_during_sleep_are_discarded() {
    let mut pair = Pair::new(None);
    let packets: Vec<_> = (0..3).map(|_| pair.send().1).collect();
    let replies: Vec<_> = packets.into_iter().map(|packet| pair.reflect(packet)).collect();
    pair.clock.sleep(Span::from_micros(30));
    // The first reply shows the interruption. The other replies were in flight during the interruption, too.
    for reply in replies {
        let reply_result = pair.receive_reply(&reply).expect("an answer");
        assert_eq!(reply_result, ReplyResult { refined: None, answered: None });
        assert_eq!(pair.receive_reply(&reply), Err("a second answer to the same probe"));
    }
    let next_exchange = pair.exchange();
    assert_eq!(next_exchange.refined, None, "the exchange before was interrupted by the sleep");
    assert_eq!(answered(&next_exchange).edge_epoch, 1);
    assert_eq!(pair.sender.expire(pair.clock.mono() + TIMEOUT), 0, "all were answered");
}

#[test]
fn reply_of_another_process_is_refused() {
    for (expected, is_accepted) in [(None, true), (Some(INSTANCE), true), (Some(INSTANCE + 1), false)] {
        let mut pair = Pair::new(None);
        pair.sender = SenderState::new(SenderConfig { instance: expected, ..config() });
        let (_, packet) = pair.send();
        let reply = pair.reflect(packet);
        let result = pair.receive_reply(&reply);
        assert_eq!(result.is_ok(), is_accepted, "{expected:?}: {result:?}");
        if !is_accepted {
            assert_eq!(
                result,
                Err("the probes are answered by another process than the one that serves the data")
            );
            let reply_of_expected_process =
                Pair::with_origin(&reply, |origin| origin.instance = INSTANCE + 1);
            assert!(
                pair.receive_reply(&reply_of_expected_process).is_ok(),
                "the expected process may still answer"
            );
        }
    }
}

#[test]
fn reply_without_expected_origin_is_refused() {
    let mut pair = Pair::new(None);
    pair.sender = SenderState::new(SenderConfig { instance: Some(INSTANCE), ..config() });
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet.clone());
    let foreign = [&reply[..44], &packet[44..]].concat();
    for reply in [&reply[..44], &foreign] {
        let result = pair.receive_reply(reply);
        assert_eq!(
            result,
            Err("the probes are answered by another program than the agent that serves the data")
        );
    }
    assert!(pair.receive_reply(&reply).is_ok());
}

#[test]
fn reply_with_damaged_tlvs_is_refused_with_reason() {
    let mut pair = Pair::raw(Some(key(7)));
    let (key, instance, clocks) = (Some(key(7)), Some(INSTANCE), RelatedClocks::Raw);
    pair.sender = SenderState::new(SenderConfig { key, instance, with_nonce: true, clocks, ..config() });
    let (_, packet) = pair.send();
    let mut altered_request = packet.clone();
    altered_request[112 + tlv::HEADER_BYTES] ^= 1;
    let reply = pair.reflect(altered_request);
    let error = pair.receive_reply(&reply).expect_err("the probe was altered");
    assert!(error.contains("HMAC of the probe's TLVs does not fit"), "{error}");
    let reply = pair.reflect(packet);
    let code = tlv::headers(&reply[112..]).find(|header| header.kind == tlv::HMAC).expect("authenticated");
    for index in 112..112 + code.offset {
        let mut altered = reply.clone();
        altered[index] ^= 1;
        let error = pair.receive_reply(&altered).expect_err("the reply was altered");
        assert!(
            !error.contains("another program"),
            "damage is not taken for another program: octet {index}: {error}"
        );
    }
    let mut altered = reply.clone();
    *altered.last_mut().expect("not empty") ^= 1;
    assert!(pair.receive_reply(&altered).expect_err("altered").contains("TLVs whose HMAC does not fit"));
    let error = pair.receive_reply(&reply[..112]).expect_err("cut off");
    assert!(error.contains("does not say which process wrote it"), "{error}");
    assert!(pair.receive_reply(&reply).is_ok());
}
