//! What a sender asks and what it makes of replies.

use std::net::SocketAddr;
use std::sync::Arc;

use peernet_clock::{Clock, ClockIdentity, ManualClock, MonoTime, Span, WallTime, Witnessed};
use peernet_probes::stamp::packet::{self, Mode, Reply};
use peernet_probes::stamp::reflector::{Arrival, Reflecting};
use peernet_probes::stamp::sender::{Departure, Heard, Return, Sending};
use peernet_probes::stamp::{tlv, uncertainty};

use crate::support::key;

const TIMEOUT: Span = Span::from_seconds(1);
const WAY: Span = Span::from_micros(700);

/// A sender and a reflector with nothing but two clocks between them, the reflector's ahead by a second.
struct Pair {
    clock: Arc<ManualClock>,
    sender: Sending,
    reflector: Reflecting,
    ahead: Span,
}

impl Pair {
    fn new(first: u32, with_key: bool) -> Self {
        let key = with_key.then(|| key(7));
        let start = WallTime::from_unix_nanos(1_800_000_000_123_456_789);
        Self {
            clock: Arc::new(ManualClock::new(start, ClockIdentity::new("b", "c"))),
            sender: Sending::new(key.clone(), 99, first, 0, TIMEOUT),
            reflector: Reflecting::new(key, 1_000_000, true),
            ahead: Span::from_seconds(1),
        }
    }

    fn send(&mut self) -> (Departure, Vec<u8>) {
        let (departure, packet) = self.sender.request(&*self.clock);
        let packet = packet.to_vec();
        assert_eq!(self.sender.sent(departure), 0);
        (departure, packet)
    }

    fn reflect(&mut self, mut packet: Vec<u8>) -> Vec<u8> {
        self.clock.advance(WAY);
        let there = ManualClock::new(self.clock.wall() + self.ahead, ClockIdentity::new("b", "d"));
        let source: SocketAddr = "10.0.0.1:40000".parse().expect("an address");
        let arrival = Arrival { source, received: there.wall(), now: self.clock.mono() };
        let answer = self.reflector.prepare(&mut packet, &arrival).expect("answered");
        there.advance(Span::from_micros(50));
        let stamp = self.reflector.complete(&answer, &mut packet, &there);
        self.reflector.sent(&answer, stamp);
        self.reflector.departed(&answer.session(), answer.sequence(), stamp + Span::from_micros(5));
        self.clock.advance(Span::from_micros(55) + WAY);
        packet
    }

    fn hear(&mut self, packet: &[u8]) -> Result<Heard, &'static str> {
        let returned = Return { kernel: None, read: self.clock.stamp(), epoch: self.clock.epoch() };
        self.sender.receive(packet, &returned)
    }

    fn exchange(&mut self) -> Heard {
        let (_, packet) = self.send();
        let reply = self.reflect(packet);
        self.hear(&reply).expect("an answer")
    }
}

#[test]
fn an_answer_gives_the_four_stamps_and_the_next_one_corrects_the_third() {
    for with_key in [false, true] {
        let mut pair = Pair::new(0, with_key);
        let begun = pair.clock.wall();
        let first = pair.exchange();
        let Witnessed { exchange, edge_elapsed, cloud_elapsed, edge_epoch, cloud_epoch } = first.answered;
        assert_eq!(first.refined, None);
        assert_eq!(exchange.sent, begun);
        assert_eq!(exchange.received, begun + WAY + pair.ahead);
        assert_eq!(exchange.replied, exchange.received + Span::from_micros(50));
        assert_eq!(exchange.returned, pair.clock.wall());
        assert_eq!(exchange.uncertainty, uncertainty::OWN);
        assert_eq!(edge_elapsed, Some(exchange.returned - exchange.sent));
        assert_eq!((cloud_elapsed, edge_epoch, cloud_epoch), (None, 0, Some(0)));

        let second = pair.exchange();
        let refined = second.refined.expect("the follow-up");
        assert_eq!(refined.exchange.replied, exchange.replied + Span::from_micros(5));
        assert_eq!((refined.exchange.sent, refined.exchange.received), (exchange.sent, exchange.received));
        assert_eq!(refined.exchange.round_trip(), WAY + WAY, "nothing is left but the way");
    }
}

#[test]
fn the_kernels_stamp_of_a_departure_is_taken_if_it_can_be_true() {
    for (late, taken) in
        [(Span::from_micros(9), true), (-Span::from_nanos(1), false), (Span::from_seconds(2), false)]
    {
        let mut pair = Pair::new(0, false);
        let begun = pair.clock.wall();
        let (departure, packet) = pair.send();
        pair.sender.departed(departure.sequence(), begun + late);
        let reply = pair.reflect(packet);
        let answered = pair.hear(&reply).expect("an answer").answered;
        assert_eq!(answered.exchange.sent, if taken { begun + late } else { begun });
        assert_eq!(answered.edge_elapsed.is_none(), taken);
    }
}

#[test]
fn numbers_run_over() {
    let mut pair = Pair::new(u32::MAX - 2, false);
    let sent: Vec<_> = (0..6).map(|_| pair.send()).collect();
    assert_eq!(sent.last().map(|(departure, _)| departure.sequence()), Some(2));
    for (_, packet) in sent.into_iter().rev() {
        let reply = pair.reflect(packet);
        pair.hear(&reply).expect("an answer, in whatever order");
    }
    assert_eq!(pair.sender.expire(pair.clock.mono() + TIMEOUT), 0);
}

#[test]
fn late_ones_are_lost_and_second_ones_count_once() {
    let mut pair = Pair::new(0, false);
    let (_, slow) = pair.send();
    let deadline = pair.sender.deadline().expect("it waits");
    assert_eq!(deadline, pair.clock.mono() + TIMEOUT);
    let heard = pair.exchange();
    assert!(heard.answered.exchange.sent < pair.clock.wall());
    pair.clock.advance(TIMEOUT - Span::from_millis(900));
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    pair.hear(&reply).expect("an answer");
    assert_eq!(pair.hear(&reply), Err("a second answer to the same probe"));

    pair.clock.advance(TIMEOUT - Span::from_millis(100));
    assert_eq!(pair.sender.expire(pair.clock.mono()), 1, "one of the two old ones was answered");
    assert_eq!(pair.sender.expire(pair.clock.mono()), 0, "counted once");
    assert_eq!(pair.sender.deadline(), None);
    let reply = pair.reflect(slow);
    assert_eq!(pair.hear(&reply), Err("late, or to no probe of ours"));
}

#[test]
fn who_did_not_get_the_question_cannot_answer_it() {
    let mut pair = Pair::new(0, false);
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    let mut forge = |change: fn(&mut Reply)| {
        let mut forged = reply.clone();
        let mut fields = Reply::parse(Mode::Open, &forged).expect("a reply");
        change(&mut fields);
        fields.write(Mode::Open, &mut forged);
        pair.hear(&forged)
    };
    assert_eq!(forge(|reply| reply.asked.ssid = 98), Err("of another session"));
    assert_eq!(forge(|reply| reply.asked.sequence += 1), Err("late, or to no probe of ours"));
    assert_eq!(forge(|reply| reply.asked.timestamp ^= 1), Err("to another stamp than was sent"));
    assert_eq!(forge(|reply| reply.received = 0), Err("without the reflector's stamps"));
    assert!(forge(|reply| reply.asked.ssid = 0).is_ok(), "as reflectors do that know of no identifiers");
}

#[test]
fn a_reply_that_was_touched_is_refused_or_its_tlvs_are_not_believed() {
    let mut pair = Pair::new(0, true);
    pair.exchange();
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet);
    for at in [0, 30, 50, 111] {
        let mut touched = reply.clone();
        touched[at] ^= 4;
        assert_eq!(pair.hear(&touched), Err("not authenticated by the key"));
    }
    let mut touched = reply;
    *touched.last_mut().expect("not empty") ^= 1;
    let heard = pair.hear(&touched).expect("its base packet is authentic");
    assert_eq!((heard.refined, heard.answered.cloud_epoch), (None, None));
    assert_eq!(heard.answered.exchange.uncertainty, uncertainty::FOREIGN);
}

#[test]
fn a_reflector_that_knows_no_tlvs_is_believed_without() {
    let mut pair = Pair::new(0, false);
    for cut in [false, true] {
        let (_, packet) = pair.send();
        let mut reply = pair.reflect(packet.clone());
        if cut {
            reply.truncate(44);
        } else {
            // It gives everything back as it came.
            reply[44..].copy_from_slice(&packet[44..]);
        }
        let answered = pair.hear(&reply).expect("an answer").answered;
        assert_eq!((answered.cloud_epoch, answered.exchange.uncertainty), (None, uncertainty::FOREIGN));
    }
}

#[test]
fn a_step_at_the_reflector_keeps_a_follow_up_from_refining() {
    let mut pair = Pair::new(0, false);
    pair.exchange();
    let (_, packet) = pair.send();
    let mut reply = pair.reflect(packet);
    // As if the reflector had noticed a step between the two.
    let place = tlv::places(&reply[44..]).find(|place| place.kind == tlv::EPOCH).expect("we ask for it");
    reply[44..][place.value].copy_from_slice(&tlv::epoch_value(1));
    let heard = pair.hear(&reply).expect("an answer");
    assert_eq!((heard.refined, heard.answered.cloud_epoch), (None, Some(1)));
}

#[test]
fn what_is_remembered_is_bounded() {
    let mut pair = Pair::new(0, false);
    let mut given_up = 0;
    for _ in 0..5000 {
        let (departure, _) = pair.sender.request(&*pair.clock);
        given_up += pair.sender.sent(departure);
    }
    let lost = pair.sender.expire(MonoTime::from_nanos(i64::MAX));
    assert_eq!(given_up + lost, 5000, "each is lost once");
    assert!(lost <= 1024, "{lost}");
}

#[test]
fn requests_are_authentic_and_padded_as_configured() {
    let clock = ManualClock::new(WallTime::from_unix_nanos(1), ClockIdentity::new("b", "c"));
    let mut sender = Sending::new(Some(key(7)), 1, 5, 100, TIMEOUT);
    let (departure, packet) = sender.request(&clock);
    assert_eq!(departure.sequence(), 5);
    assert!(packet::is_sealed(&key(7), packet));
    assert!(tlv::are_intact(Some(&key(7)), 5, &packet[112..]));
    assert_eq!(packet.len(), 112 + 20 + 12 + 20 + 104);
    let mut sender = Sending::new(None, 1, 5, 0, TIMEOUT);
    let (_, packet) = sender.request(&clock);
    assert_eq!(packet.len(), 44 + 20 + 12);
}
