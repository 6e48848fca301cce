//! Arbitrary bytes as a packet for the prober and the reflector, for the fuzz target in `fuzz/` and for a test.

use std::net::SocketAddr;

use peernet_clock::{Clock, ClockIdentity, ManualClock, RelatedClocks, Span, WallTime};

use crate::Refusal;
use crate::stamp::auth::Key;
use crate::stamp::packet::{self, Mode, Reply};
use crate::stamp::reflector::{Arrival, ReflectorState};
use crate::stamp::sender::{ReplyArrival, SenderConfig, SenderState};
use crate::stamp::timestamp::Format;
use crate::stamp::tlv;

// Bits of the first byte. They select the configuration and changes to the packet. Without the changes, random bytes
// would hardly ever pass the checks.

/// Both ends have a key.
const WITH_KEY: u8 = 1;
/// The reflector distinguishes sessions.
const STATEFUL: u8 = 2;
/// The packet gets the right authentication codes.
const AUTHENTIC: u8 = 4;
/// The packet gets the number, stamp and session identifier of the sender's request.
const MATCHING: u8 = 8;
/// The kernel does not stamp the departure of the request.
const PROGRAM_STAMPS: u8 = 16;
/// The sender relates both free-running clocks.
const RAW_CLOCKS: u8 = 32;

/// Handles a packet as the prober and as the reflector. The bits of the first byte select the options above; the other
/// bytes are the packet.
///
/// # Panics
/// If an answer has another length than its request, if two reflectors could form a loop, or if an answer is accepted
/// twice.
pub fn any_packet(data: &[u8]) {
    let Some((&options, bytes)) = data.split_first() else { return };
    let key = (options & WITH_KEY != 0).then(|| Key::from_bytes(&[7; 32]));
    let start = WallTime::from_unix_nanos(1_800_000_000_000_000_000);
    let clock = ManualClock::new(start, ClockIdentity::new("fuzz", "system"));
    feed_reflector(options, key.as_ref(), bytes, &clock);
    feed_sender(options, key.as_ref(), bytes, &clock);
}

fn feed_reflector(options: u8, key: Option<&Key>, bytes: &[u8], clock: &ManualClock) {
    let mut packet = bytes.to_vec();
    authenticate(options, key, &mut packet);
    let (instance, max_per_source_hz, stateful) = (1, 10, options & STATEFUL != 0);
    let mut reflector = ReflectorState::new(key.cloned(), instance, max_per_source_hz, stateful);
    let source = SocketAddr::from(([10, 0, 0, 1], 40_000));
    // The request arrives twice, because the second request finds a session.
    for _ in 0..2 {
        let mut answer = packet.clone();
        let arrival =
            Arrival { source, received: clock.wall(), received_raw: clock.raw(), now: clock.mono() };
        let Ok(prepared) = reflector.prepare(&mut answer, &arrival) else { return };
        clock.advance(Span::from_micros(20));
        let stamp = reflector.complete(&prepared, &mut answer, clock);
        reflector.record_sent(&prepared, stamp);
        let departure = stamp + Span::from_micros(1);
        reflector.record_departure(&prepared.session(), prepared.sequence(), departure.wall, departure.raw);
        assert_eq!(answer.len(), packet.len(), "an answer has the length of its request");
        let result = reflector.prepare(&mut answer, &arrival);
        assert_eq!(result.map(|_| ()), Err(Refusal::Reply), "an answer is not answered");
    }
}

fn feed_sender(options: u8, key: Option<&Key>, bytes: &[u8], clock: &ManualClock) {
    let mode = Mode::for_key(key);
    let mut sender = SenderState::new(SenderConfig {
        key: key.cloned(),
        instance: None,
        with_nonce: false,
        clocks: if options & RAW_CLOCKS != 0 { RelatedClocks::Raw } else { RelatedClocks::RawToWall },
        ssid: 5,
        // The number of the second request wraps around to zero.
        first_sequence: u32::MAX,
        padding_bytes: 0,
        timeout: Span::from_seconds(1),
    });
    let mut packet = bytes.to_vec();
    for round in 0..2 {
        let (departure, _) = sender.request(clock);
        let sent = clock.wall();
        sender.record_sent(departure);
        if options & PROGRAM_STAMPS == 0 {
            sender.record_departure(departure.sequence(), sent + Span::from_micros(1), clock.wall_ahead());
        }
        if options & MATCHING != 0
            && let Some(mut reply) = Reply::parse(mode, &packet)
        {
            reply.request.sequence = departure.sequence();
            reply.request.timestamp = Format::Ntp.encode(sent);
            reply.request.ssid = 5;
            reply.write(mode, &mut packet);
        }
        authenticate(options, key, &mut packet);
        clock.advance(Span::from_millis(3));
        let arrival = ReplyArrival { kernel: None, read: clock.stamp(), ahead: clock.wall_ahead(), epoch: 0 };
        if let Ok(result) = sender.receive(&packet, &arrival) {
            let observation = result.answered.expect("the clock is not interrupted");
            assert_eq!(observation.exchange.returned, arrival.read.raw);
            assert!(result.refined.is_none() || round == 1, "the first answer refines no earlier exchange");
            assert!(sender.receive(&packet, &arrival).is_err(), "an answer counts once");
        }
    }
    sender.expire(clock.mono() + Span::from_seconds(2));
    assert_eq!(sender.deadline(), None, "no probe waits for ever");
}

fn authenticate(options: u8, key: Option<&Key>, packet: &mut [u8]) {
    if options & AUTHENTIC != 0
        && let Some(key) = key
        && packet.len() >= Mode::Authenticated.base_bytes()
    {
        let (base, tlvs) = packet.split_at_mut(Mode::Authenticated.base_bytes());
        let sequence = u32::from_be_bytes([base[0], base[1], base[2], base[3]]);
        tlv::authenticate(key, sequence, tlvs);
        packet::authenticate(key, packet);
    }
}
