use peernet_clock::{
    ClockClaim, ClockFaultStep, ClockFaults, DelaySource, Exchange, ExchangeCounts, Interval, Offset,
    RawTime, Span, Verdict, WallTime,
};
use proptest::prelude::*;

use super::super::{
    Accounting, ClockSample, DelayPoint, DelaySecond, HostClock, HostMetrics, Incident, IncidentKind,
    LinkLive, LiveUpdate, NetworkName, ProbeCounts, Probing, RoundTrip,
};
use super::*;

fn interval(lo: i64, hi: i64) -> Interval {
    Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) }
}

/// Returns a clock sample in which some optional fields have values and some have none.
fn clock_sample() -> ClockSample {
    let at = WallTime::from_unix_nanos;
    let exchange = Exchange {
        sent: RawTime::from_nanos(1_000),
        received: RawTime::from_nanos(-2_000),
        replied: RawTime::from_nanos(-1_500),
        returned: RawTime::from_nanos(4_000),
        uncertainty: Span::from_nanos(2),
    };
    let delays = DelaySecond {
        count: 5,
        median: Some(DelayPoint {
            value: Span::from_micros(600),
            bounds: interval(500_000, 700_000),
            bits_per_second: Some(8e6),
        }),
        verdict: Verdict::Limited,
    };
    ClockSample {
        peer: HostId::random(),
        peer_name: "cloud".parse().expect("a name"),
        at: at(1_000_000_000),
        relation_period: u64::MAX,
        max_drift_ppm: 50.0,
        upper: Some(exchange),
        lower: None,
        offset: Some(Offset {
            at: at(1_000_000_000),
            estimate: Span::from_nanos(-4_000),
            bounds: interval(-5_500, -3_000),
            source: DelaySource::Intersection,
            sources: vec![
                (DelaySource::InBand, interval(-6_000, -3_000)),
                (DelaySource::Chrony, interval(-5_500, 9)),
            ],
            verdict: Verdict::Ok,
            skew_ppm: Some(-12.5),
            exchanges: 17,
            age: Some(Span::from_millis(80)),
        }),
        probes: ProbeCounts { sent: 10, answered: 9, lost: 1, refused: 0 },
        exchanges: ExchangeCounts { accepted: 9, impossible: 1, outliers: 2, stepped: 3, restarts: 4 },
        round_trip: Some(RoundTrip { min: Span::from_micros(2), median: Span::from_micros(3) }),
        up: Some(delays),
        down: Some(DelaySecond { median: None, ..delays }),
        network: NetworkName::default(),
        basis: None,
    }
}

fn host_clock() -> HostClock {
    HostClock {
        claim: Some(ClockClaim { source: DelaySource::Chrony, error: interval(-7, 7) }),
        text: "chrony, stratum 2, to 10.0.0.1".into(),
        epoch: 3,
        faults: Some(ClockFaults {
            offset: Span::from_seconds(1),
            drift_ppm: -50.0,
            steps: vec![ClockFaultStep::wall_step(Span::from_seconds(9), Span::from_seconds(-3))],
            since: WallTime::from_unix_nanos(5),
        }),
        clocksource: None,
    }
}

fn some_events(count: usize) -> Vec<Event> {
    let incident = Incident {
        at: WallTime::from_unix_nanos(7),
        kind: IncidentKind::Connected,
        pipeline: Some("line".parse().expect("a name")),
        run: None,
        peer: Some(HostId::random()),
        text: "back after 2 s".into(),
    };
    [Event::Incident(incident), Event::Clock(Box::new(clock_sample()))]
        .into_iter()
        .cycle()
        .take(count)
        .collect()
}

fn body_of(events: &[Event]) -> Vec<u8> {
    let mut body = Vec::new();
    events.iter().for_each(|event| encode_into(&mut body, event));
    body
}

fn head_of(number: u64, events: u32, body: &[u8]) -> BatchHead {
    let previous_chain = ChainHash::from_bytes([3; 16]);
    let (host, stream) = (HostId::random(), StreamId::random());
    let (chain, events_before) = (previous_chain.next(events, body), 100);
    BatchHead { host, stream, process: 7, number, previous_chain, chain, events, events_before }
}

/// Returns a frame of `count` events, its head, and the events. The frame is batch number 5.
fn frame_of(count: usize, compress: bool) -> (Bytes, BatchHead, Vec<Event>) {
    let events = some_events(count);
    let body = body_of(&events);
    let head = head_of(5, count as u32, &body);
    (encode_batch(&head, &body, compress).into(), head, events)
}

#[test]
fn batch_is_decoded_as_encoded() {
    for (number, count, compress) in
        [(1, 0, true), (300, 1, false), (70_000, 40, true), (u64::MAX, 4_000, true)]
    {
        let sent = some_events(count);
        let body = body_of(&sent);
        let head = head_of(number, count as u32, &body);
        let frame = Bytes::from(encode_batch(&head, &body, compress));
        assert_eq!(decode_batch_head(&frame), Some(head));
        if count > 1 {
            assert_eq!(frame.len() < body.len(), compress, "a frame of {} bytes", frame.len());
        }
        let decoded_body = decode_batch_body(frame).expect("an intact body");
        assert!(decoded_body == body);
        assert_eq!(decode_events(&decoded_body, head.events), Ok(sent));
    }
}

#[test]
fn incompressible_body_is_sent_uncompressed() {
    let body: Vec<u8> = (0..=255_u8).collect();
    let head = head_of(1, 1, &body);
    let frame = encode_batch(&head, &body, true);
    assert_eq!(frame.len(), BATCH_HEAD_BYTES + body.len());
    assert_eq!(decode_batch_body(frame.into()).as_deref(), Ok(&body[..]));
}

#[test]
fn batch_is_not_decoded_as_message_nor_message_as_batch() {
    let (frame, ..) = frame_of(2, false);
    assert!(matches!(decode::<ToAggregator>(&frame), Err(CodecError::Malformed(_))));
    assert!(matches!(decode::<ToAgent>(&frame), Err(CodecError::Malformed(_))));
    for message in [encode(&ToAggregator::Goodbye(HostId::random())), encode(&ToAgent::Unknown), Vec::new()] {
        assert_eq!(decode_batch_head(&message), None);
        assert!(matches!(decode_batch_body(message.into()), Err(CodecError::Malformed(_))));
    }
}

#[test]
fn compressed_message_is_read_within_size_limit() {
    let refused = ToAgent::Refused { reason: "no ".repeat(1_000) };
    let frame = encode_compressed(&refused);
    // Zeros make the frame as long as a batch, so that only its second byte shows that it is no batch.
    assert!(frame.len() < 200 && decode_batch_head(&[&frame[..], &[0; 200]].concat()).is_none());
    assert_eq!(decode::<ToAgent>(&frame), Ok(refused));
    assert_eq!(
        encode_compressed(&ToAgent::Unknown),
        encode(&ToAgent::Unknown),
        "a message that compression does not shorten is not compressed"
    );
    for length in [MAX_MESSAGE_BYTES as u32 + 1, 100] {
        // Bytes 2 to 5 state the length of the message before its compression.
        let mut wrong_length = frame.clone();
        wrong_length[2..6].copy_from_slice(&length.to_be_bytes());
        decode::<ToAgent>(&wrong_length).expect_err("the stated length is wrong");
    }
    (0..frame.len())
        .for_each(|end| drop(decode::<ToAgent>(&frame[..end]).expect_err("the frame is truncated")));
}

#[test]
fn head_of_damaged_batch_is_readable() {
    for compress in [false, true] {
        let (frame, head, _) = frame_of(2, compress);
        for damaged in [frame.slice(..frame.len() - 1), Bytes::from([&frame[..], &[0]].concat())] {
            assert_eq!(decode_batch_head(&damaged), Some(head));
            assert_eq!(decode_batch_body(damaged), Err(CodecError::Damaged(5)));
        }
        assert_eq!(decode_batch_head(&frame[..BATCH_HEAD_BYTES - 1]), None);
    }
}

#[test]
fn wrong_number_of_events_is_refused() {
    let body = body_of(&some_events(3));
    assert_eq!(decode_events(&body, 3).map(|events| events.len()), Ok(3));
    for count in [2, 4, body.len() as u32 + 1, u32::MAX] {
        assert!(matches!(decode_events(&body, count), Err(CodecError::Malformed(_))), "{count}");
    }
    assert_eq!(decode_events(&[], 0), Ok(Vec::new()));
}

#[test]
fn body_that_decompresses_beyond_limit_is_refused() {
    // The compressed body is far shorter than the limit. Only the length in the head shows that the body is too long.
    let body = vec![0; 8 * MAX_MESSAGE_BYTES];
    let mut frame = encode_batch(&head_of(5, 1, &body), &body, true);
    assert!(frame.len() < MAX_MESSAGE_BYTES);
    assert_eq!(decode_batch_body(frame.clone().into()), Err(CodecError::TooLong(body.len())));
    // The last four bytes of the head state the length of the body.
    frame[BATCH_HEAD_BYTES - 4..BATCH_HEAD_BYTES].copy_from_slice(&1_000_u32.to_be_bytes());
    assert_eq!(decode_batch_body(frame.into()), Err(CodecError::Damaged(5)));
}

#[test]
fn live_update_with_links_is_decoded_as_encoded() {
    let probing = [
        Probing::On { address: "udp://h:8620".into(), rate_hz: 10.0, stamps: "program".into() },
        Probing::Unanswered { address: "udp://h:8620".into(), reason: Some("another key".into()) },
        Probing::Unanswered { address: "udp://h:8620".into(), reason: None },
        Probing::Off("both read one clock".into()),
    ];
    let link = |probing| LinkLive {
        peer: HostId::random(),
        peer_name: "cloud".parse().expect("a name"),
        networks: vec!["zmq-tcp".into()],
        pipelines: vec!["line".parse().expect("a name")],
        same_clock: false,
        probing,
        edge: Some(host_clock()),
        cloud: None,
        latest_sample: clock_sample(),
        connections: Vec::new(),
        reflector: None,
    };
    let update = ToAggregator::Live(LiveUpdate {
        host: HostId::random(),
        sent: WallTime::from_unix_nanos(1_000_000_001),
        pipelines: vec![],
        links: probing.map(link).into(),
        clock: host_clock(),
        metrics: HostMetrics::default(),
        accounting: Accounting::default(),
    });
    assert_eq!(decode(&encode(&update)), Ok(update));
}

#[test]
fn too_long_too_deep_and_trailing_bytes_are_refused() {
    let frame = encode(&ToAgent::Unknown);
    assert_eq!(decode(&frame), Ok(ToAgent::Unknown));
    assert_eq!(decode::<ToAgent>(&[&frame[..], &[0]].concat()), Err(CodecError::Trailing(1)));
    let long = vec![0; MAX_MESSAGE_BYTES + 1];
    assert_eq!(decode::<ToAgent>(&long), Err(CodecError::TooLong(long.len())));
    // Each byte begins a MessagePack array of one element.
    let deep = vec![0x91; 100_000];
    assert!(matches!(decode::<ToAggregator>(&deep), Err(CodecError::Malformed(_))));
}

proptest! {
    #[test]
    fn arbitrary_bytes_cause_no_panic(bytes: Vec<u8>, count: u32) {
        let _ = (decode::<ToAggregator>(&bytes), decode::<ToAgent>(&bytes), decode_events(&bytes, count));
        let batch: Bytes = [&[FRAME_MARKER], &bytes[..]].concat().into();
        let _ = (decode_batch_head(&batch), decode_batch_body(batch.clone()), decode_batch_head(&bytes), decode_batch_body(bytes.into()));
    }

    #[test]
    fn damaged_messages_cause_no_panic(at: prop::sample::Index, byte: u8, cut: prop::sample::Index) {
        let mut frame = encode(&ToAggregator::Goodbye(HostId::random()));
        let at_message = at.index(frame.len());
        frame[at_message] = byte;
        let _ = (decode::<ToAggregator>(&frame), decode::<ToAggregator>(&frame[..cut.index(at_message + 1)]));
        let mut body = body_of(&some_events(2));
        let at_body = at.index(body.len());
        body[at_body] = byte;
        let _ = (decode_events(&body, 2), decode_events(&body[..cut.index(at_body + 1)], 2));
    }

    /// Checks that every changed bit is detected: either the head differs, or the body is refused.
    #[test]
    fn every_changed_bit_is_detected(bit: prop::sample::Index, compress: bool) {
        let (frame, head, _) = frame_of(2, compress);
        let mut damaged = frame.to_vec();
        let bit = bit.index(8 * frame.len());
        damaged[bit / 8] ^= 1 << (bit % 8);
        if decode_batch_head(&damaged) == Some(head) {
            prop_assert!(decode_batch_body(damaged.into()).is_err(), "bit {bit}");
        } else {
            prop_assert!(bit / 8 < BATCH_HEAD_BYTES);
        }
    }

    #[test]
    fn every_truncation_is_detected(cut: prop::sample::Index, compress: bool) {
        let (frame, ..) = frame_of(2, compress);
        prop_assert!(decode_batch_body(frame.slice(..cut.index(frame.len()))).is_err());
    }
}
