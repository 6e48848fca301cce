//! Tests of the reflector's state machine.

use std::net::SocketAddr;

use peernet_clock::{Clock, ClockIdentity, ManualClock, Span, WallTime};
use peernet_probes::Refusal;
use peernet_probes::stamp::auth::Key;
use peernet_probes::stamp::packet::{self, Mode, Reply, Request};
use peernet_probes::stamp::reflector::{Arrival, PreparedReply, ReflectorState};
use peernet_probes::stamp::timestamp::{ErrorEstimate, Format};
use peernet_probes::stamp::tlv::{self, FollowUp, Origin, RawStamps};

use crate::support::{INSTANCE, key};

const NOW: WallTime = WallTime::from_unix_nanos(1_800_000_000_000_000_000);

fn clock() -> ManualClock {
    ManualClock::new(NOW, ClockIdentity::new("b", "c"))
}

fn source() -> SocketAddr {
    "10.0.0.1:40000".parse().expect("an address")
}

fn arrival(clock: &ManualClock) -> Arrival {
    Arrival { source: source(), received: clock.wall(), received_raw: clock.raw(), now: clock.mono() }
}

/// Returns a reflector that distinguishes STAMP sessions.
fn stateful_reflector(key: Option<Key>) -> ReflectorState {
    let (max_per_source_hz, stateful) = (100, true);
    ReflectorState::new(key, INSTANCE, max_per_source_hz, stateful)
}

/// Returns a reflector that does not distinguish STAMP sessions.
fn stateless_reflector(key: Option<Key>) -> ReflectorState {
    let (max_per_source_hz, stateful) = (100, false);
    ReflectorState::new(key, INSTANCE, max_per_source_hz, stateful)
}

/// Returns a request with these TLVs (type, value).
fn request(key: Option<&Key>, sequence: u32, ssid: u16, tlvs: &[(u8, &[u8])]) -> Vec<u8> {
    let mode = Mode::for_key(key);
    let mut packet = vec![0; mode.base_bytes()];
    let timestamp = Format::Ntp.encode(NOW - Span::from_seconds(100));
    let estimate = ErrorEstimate::new(Format::Ntp, Span::ZERO);
    Request { sequence, timestamp, estimate, ssid }.write(mode, &mut packet);
    for (kind, value) in tlvs {
        tlv::push(&mut packet, *kind, value);
    }
    if let Some(key) = key {
        tlv::authenticate(key, sequence, &mut packet[112..]);
        packet::authenticate(key, &mut packet);
    }
    packet
}

fn answer(
    reflector: &mut ReflectorState,
    clock: &ManualClock,
    packet: &mut [u8],
) -> Result<PreparedReply, Refusal> {
    let answer = reflector.prepare(packet, &arrival(clock))?;
    let stamp = reflector.complete(&answer, packet, clock);
    reflector.record_sent(&answer, stamp);
    Ok(answer)
}

fn tlvs_of(packet: &[u8], base: usize) -> Vec<(u8, u8, Vec<u8>)> {
    let tlvs = &packet[base..];
    tlv::headers(tlvs).map(|header| (header.kind, header.flags, tlvs[header.value].to_vec())).collect()
}

#[test]
fn reply_contains_both_stamps_and_the_request() {
    for format in [Format::Ntp, Format::Ptp] {
        let clock = clock();
        let mut reflector = stateless_reflector(None);
        let request_fields = Request {
            sequence: 77,
            timestamp: format.encode(NOW - Span::from_seconds(3)),
            estimate: ErrorEstimate::new(format, Span::from_millis(1)),
            ssid: 513,
        };
        let mut packet = vec![0; 44];
        request_fields.write(Mode::Unauthenticated, &mut packet);
        let prepared = reflector.prepare(&mut packet, &arrival(&clock)).expect("answered");
        clock.advance(Span::from_micros(30));
        reflector.complete(&prepared, &mut packet, &clock);
        let reply = Reply::parse(Mode::Unauthenticated, &packet).expect("long enough");
        assert_eq!((reply.request, reply.sequence, packet.len()), (request_fields, 77, 44));
        assert_eq!(reply.estimate.format(), format, "in the format of the request");
        assert_eq!(format.decode(reply.received, NOW), Some(NOW));
        assert_eq!(format.decode(reply.timestamp, NOW), Some(NOW + Span::from_micros(30)));
    }
}

#[test]
fn replies_are_numbered_per_session() {
    let clock = clock();
    let mut reflector = stateful_reflector(None);
    let number = |reflector: &mut ReflectorState, sequence, ssid| {
        let mut packet = request(None, sequence, ssid, &[]);
        answer(reflector, &clock, &mut packet).expect("answered").sequence()
    };
    assert_eq!(
        [number(&mut reflector, 10, 1), number(&mut reflector, 12, 1)],
        [0, 1],
        "one was lost on its way"
    );
    assert_eq!(number(&mut reflector, 500, 2), 0, "another session");
    assert_eq!(number(&mut reflector, 13, 1), 2);
}

#[test]
fn follow_up_contains_departure_of_previous_reply() {
    let clock = clock();
    let mut reflector = stateful_reflector(None);
    let empty_follow_up: (u8, &[u8]) = (tlv::FOLLOW_UP, &[0; FollowUp::BYTES]);
    let follow_up = |packet: &[u8]| match &tlvs_of(packet, 44)[..] {
        [(tlv::FOLLOW_UP, 0, value)] => FollowUp::from_value(value),
        other => panic!("{other:?}"),
    };
    let mut first_packet = request(None, 5, 1, &[empty_follow_up]);
    let prepared = answer(&mut reflector, &clock, &mut first_packet).expect("answered");
    assert_eq!(follow_up(&first_packet), None, "there was no reply before");
    // The first departure is used. Three others are ignored: before the program's stamp, ten seconds after it, and of
    // another reply.
    let (session, departure) = (prepared.session(), NOW + Span::from_micros(17));
    let mut record_departure = |sequence, after| {
        reflector.record_departure(&session, sequence, NOW + after, ManualClock::FIRST_RAW + after);
    };
    record_departure(prepared.sequence(), Span::from_micros(17));
    record_departure(prepared.sequence(), -Span::from_nanos(1));
    record_departure(prepared.sequence(), Span::from_seconds(10));
    record_departure(prepared.sequence() + 1, Span::from_micros(20));

    clock.advance(Span::from_millis(1));
    let mut second_packet = request(None, 6, 1, &[empty_follow_up]);
    answer(&mut reflector, &clock, &mut second_packet).expect("answered");
    assert_eq!(
        follow_up(&second_packet),
        Some(FollowUp { sequence: 0, timestamp: Format::Ntp.encode(departure) })
    );

    let mut stateless = stateless_reflector(None);
    for _ in 0..2 {
        let mut packet = request(None, 7, 1, &[(tlv::FOLLOW_UP, &[9; FollowUp::BYTES])]);
        answer(&mut stateless, &clock, &mut packet).expect("answered");
        assert_eq!(
            tlvs_of(&packet, 44),
            [(tlv::FOLLOW_UP, 0, vec![0; FollowUp::BYTES])],
            "a reflector without sessions returns zeros"
        );
    }
}

#[test]
fn reply_returns_tlvs_flagged_in_order() {
    let clock = clock();
    let mut reflector = stateful_reflector(None);
    let mut packet = request(
        None,
        1,
        1,
        &[
            (99, b"unknown"),
            (tlv::EXTRA_PADDING, &[5; 30]),
            (tlv::FOLLOW_UP, &[1; 7]),
            (tlv::ORIGIN, &Origin::default().to_value()),
            (tlv::ORIGIN, b"another's"),
            (tlv::RAW_STAMPS, &RawStamps::default().to_value()),
            (tlv::RAW_STAMPS, &[0; RawStamps::BYTES]),
            (3, b""),
        ],
    );
    // The last TLV claims more bytes than there are.
    let length = packet.len();
    packet[length - 1] = 200;
    // The step begins epoch 1 of the wall clock.
    clock.step_wall(Span::from_micros(1));
    answer(&mut reflector, &clock, &mut packet).expect("answered");
    let origin = Origin { epoch: 1, instance: INSTANCE };
    let raw = RawStamps { epoch: 0, received: clock.raw(), replied: clock.raw(), previous: None };
    assert_eq!(
        tlvs_of(&packet, 44),
        [
            (99, tlv::UNRECOGNISED, b"unknown".to_vec()),
            (tlv::EXTRA_PADDING, 0, vec![5; 30]),
            (tlv::FOLLOW_UP, tlv::MALFORMED, vec![0; 7]),
            (tlv::ORIGIN, 0, origin.to_value().to_vec()),
            (tlv::ORIGIN, tlv::UNRECOGNISED, b"another's".to_vec()),
            (tlv::RAW_STAMPS, 0, raw.to_value().to_vec()),
            (tlv::RAW_STAMPS, tlv::UNRECOGNISED, vec![0; RawStamps::BYTES]),
            (3, tlv::UNRECOGNISED | tlv::MALFORMED, Vec::new()),
        ]
    );
}

#[test]
fn unauthenticated_tlvs_are_returned_without_effect() {
    let (clock, key) = (clock(), key(7));
    let empty_follow_up: &[u8] = &[0; FollowUp::BYTES];
    let code: &[u8] = &[0; 16];
    let mut reflector = stateful_reflector(Some(key.clone()));
    let request_with_key = |tlvs: &[(u8, &[u8])]| request(Some(&key), 1, 1, tlvs);
    let mut flags = |mut packet: Vec<u8>| {
        answer(&mut reflector, &clock, &mut packet).expect("the base packet is authentic");
        assert!(packet::is_authentic(&key, &packet), "the answer is authenticated");
        let sequence = Reply::parse(Mode::Authenticated, &packet).expect("long").sequence;
        let flags: Vec<u8> = tlvs_of(&packet, 112).iter().map(|(_, flags, _)| *flags).collect();
        (flags, tlv::are_intact(Some(&key), sequence, &packet[112..]))
    };
    let not_intact = tlv::NOT_INTACT;
    let valid_request = request_with_key(&[(tlv::FOLLOW_UP, empty_follow_up), (tlv::HMAC, code)]);
    let mut altered_request = valid_request.clone();
    *altered_request.last_mut().expect("not empty") ^= 1;
    assert_eq!(flags(valid_request), (vec![0, 0], true));
    assert_eq!(flags(altered_request).0, [not_intact, not_intact], "the TLVs were altered");
    let request_without_code = request_with_key(&[(tlv::FOLLOW_UP, empty_follow_up)]);
    assert_eq!(flags(request_without_code).0, [not_intact], "without a code");
    let padded_request = request_with_key(&[(tlv::EXTRA_PADDING, empty_follow_up)]);
    assert_eq!(flags(padded_request).0, [0], "padding alone needs no code");
    let request_with_code_first = request_with_key(&[(tlv::HMAC, code), (tlv::FOLLOW_UP, empty_follow_up)]);
    assert_eq!(flags(request_with_code_first).0, [not_intact, not_intact], "the code is not at the end");
    let request_with_padding_last = request_with_key(&[
        (tlv::FOLLOW_UP, empty_follow_up),
        (tlv::HMAC, code),
        (tlv::EXTRA_PADDING, empty_follow_up),
    ]);
    assert_eq!(flags(request_with_padding_last).0, [0; 3], "only padding may follow the code");

    let mut keyless = stateful_reflector(None);
    let mut packet = request(None, 1, 1, &[(tlv::FOLLOW_UP, empty_follow_up), (tlv::HMAC, code)]);
    answer(&mut keyless, &clock, &mut packet).expect("answered");
    assert!(
        tlvs_of(&packet, 44).iter().all(|(_, flags, _)| *flags == not_intact),
        "a reflector without a key cannot verify the code"
    );
}

#[test]
fn unauthenticated_request_is_refused_without_using_rate() {
    let (clock, key) = (clock(), key(7));
    let (max_per_source_hz, stateful) = (3, true);
    let mut reflector = ReflectorState::new(Some(key.clone()), INSTANCE, max_per_source_hz, stateful);
    let valid_request = request(Some(&key), 1, 1, &[]);
    for index in [0, 20, 60, 111] {
        let mut packet = valid_request.clone();
        packet[index] ^= 1;
        assert_eq!(
            answer(&mut reflector, &clock, &mut packet).expect_err("altered"),
            Refusal::Unauthenticated
        );
    }
    let mut request_without_key = request(None, 1, 1, &[(tlv::EXTRA_PADDING, &[0; 100])]);
    assert_eq!(
        answer(&mut reflector, &clock, &mut request_without_key).expect_err("without a key"),
        Refusal::Unauthenticated
    );
    let answers =
        (0..9).filter(|_| answer(&mut reflector, &clock, &mut valid_request.clone()).is_ok()).count();
    assert_eq!(answers, 3, "the refused requests used up none of the rate");
}

#[test]
fn session_key_applies_to_authenticated_requests_only() {
    let (clock, own_key, other_key) = (clock(), &key(7), &key(8));
    let reflector_with_session_key = || stateful_reflector(None).with_session_key(Some(key(7)));
    let mut reflector = reflector_with_session_key();
    let (empty_follow_up, code): (&[u8], &[u8]) = (&[0; FollowUp::BYTES], &[0; 16]);
    let request_with_key =
        |key: &Key| request(Some(key), 1, 1, &[(tlv::FOLLOW_UP, empty_follow_up), (tlv::HMAC, code)]);

    let request_packet = request_with_key(own_key);
    let mut packet = request_packet.clone();
    answer(&mut reflector, &clock, &mut packet).expect("a peer with a session");
    assert!(packet::is_authentic(own_key, &packet) && tlv::are_intact(Some(own_key), 0, &packet[112..]));
    assert_eq!(packet.len(), request_packet.len());
    // Neither this reflector nor that of another process answers the answer.
    let mut other_reflector = stateful_reflector(None).with_session_key(Some(other_key.clone()));
    for reflector in [&mut reflector, &mut other_reflector] {
        let result = answer(reflector, &clock, &mut packet.clone()).map(|_| ());
        assert!(matches!(result, Err(Refusal::Reply | Refusal::Unauthenticated)), "{result:?}");
    }

    let mut stale_request = request_with_key(other_key);
    let result = answer(&mut reflector, &clock, &mut stale_request).expect_err("of another process");
    assert_eq!(result, Refusal::Unauthenticated);
    let mut altered_request = request_with_key(own_key);
    altered_request[20] ^= 1;
    assert_eq!(
        answer(&mut reflector, &clock, &mut altered_request).expect_err("altered"),
        Refusal::Unauthenticated
    );

    // Requests without a key, of any length, are answered as without a session key.
    let padding: &[u8] = &[0; 300];
    for tlvs in [
        &[][..],
        &[(tlv::FOLLOW_UP, empty_follow_up)],
        &[(tlv::FOLLOW_UP, empty_follow_up), (tlv::EXTRA_PADDING, padding)],
    ] {
        let mut reflectors = [reflector_with_session_key(), stateful_reflector(None)];
        let [answer_with_session_key, answer_without_session_key] = reflectors.each_mut().map(|reflector| {
            let mut packet = request(None, 1, 1, tlvs);
            answer(reflector, &clock, &mut packet).expect("answered");
            packet
        });
        assert_eq!(answer_with_session_key, answer_without_session_key);
    }
    // A mandatory key takes precedence.
    let mut reflector_with_mandatory_key =
        stateful_reflector(Some(other_key.clone())).with_session_key(Some(own_key.clone()));
    let mut packet = request_with_key(own_key);
    assert_eq!(
        answer(&mut reflector_with_mandatory_key, &clock, &mut packet).expect_err("another"),
        Refusal::Unauthenticated
    );
    let mut request_without_key = request(None, 1, 1, &[]);
    let result = answer(&mut reflector_with_mandatory_key, &clock, &mut request_without_key)
        .expect_err("without a key");
    assert_eq!(result, Refusal::Short, "shorter than the base packet of an authenticated request");
}

#[test]
fn reflectors_do_not_answer_each_other() {
    let clock = clock();
    for format in [Format::Ntp, Format::Ptp] {
        for key in [None, Some(key(7))] {
            let mode = Mode::for_key(key.as_ref());
            let mut first_reflector = stateful_reflector(key.clone());
            let mut second_reflector = stateless_reflector(key.clone());
            let mut packet = request(key.as_ref(), 1, 1, &[]);
            let mut request_fields = Request::parse(mode, &packet).expect("long enough");
            request_fields.estimate = ErrorEstimate::new(format, Span::ZERO);
            request_fields.write(mode, &mut packet);
            if let Some(key) = &key {
                packet::authenticate(key, &mut packet);
            }
            answer(&mut first_reflector, &clock, &mut packet).expect("a request");
            // The other host's clock is years away, and its packet took long to arrive.
            clock.advance(Span::from_seconds(7));
            clock.step_wall(Span::from_seconds(86_400 * 3000));
            assert_eq!(
                answer(&mut second_reflector, &clock, &mut packet).expect_err("a reply"),
                Refusal::Reply
            );
        }
    }
}

#[test]
fn request_from_port_0_is_refused() {
    let clock = clock();
    let mut reflector = stateful_reflector(None);
    let arrival_from_port_0 =
        Arrival { source: "10.0.0.1:0".parse().expect("an address"), ..arrival(&clock) };
    let result = reflector.prepare(&mut request(None, 1, 1, &[]), &arrival_from_port_0);
    assert_eq!(result.expect_err("port 0"), Refusal::NoPort);
}

#[test]
fn twamp_light_senders_with_any_padding_are_answered() {
    let clock = clock();
    let mut reflector = stateless_reflector(None);
    for (padding, length) in [(0u8, 44), (0, 341), (0xFF, 1400), (0x55, 45)] {
        let mut packet = vec![padding; length];
        packet[..4].copy_from_slice(&9u32.to_be_bytes());
        packet[4..12].copy_from_slice(&Format::Ntp.encode(NOW).to_be_bytes());
        packet[12..14].copy_from_slice(&1u16.to_be_bytes());
        answer(&mut reflector, &clock, &mut packet).expect("answered");
        assert_eq!(packet.len(), length);
        let reply = Reply::parse(Mode::Unauthenticated, &packet).expect("long enough");
        assert_eq!((reply.request.sequence, Format::Ntp.decode(reply.received, NOW)), (9, Some(NOW)));
    }
    let result = answer(&mut reflector, &clock, &mut [0; 43]);
    assert_eq!(result.expect_err("too short"), Refusal::Short);
}
