//! Messages of the event stream to bytes and back: MessagePack, one message a frame.

use std::io::Write;

use rmp::{decode, encode as put};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{StreamId, ToAgent, ToAggregator};
use crate::HostId;

/// Longest message that is read. A batch is cut far below it; one tree of the largest size fits.
pub const MAX_MESSAGE_BYTES: usize = 4 * 1024 * 1024;

/// Deepest nesting of values (not of nodes: a tree is one byte string).
const MAX_NESTING: usize = 32;

/// Name of [`ToAggregator::Batch`] on the wire.
const BATCH: &str = "Batch";

/// Bytes that are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// Longer than anything that is read.
    #[error("a message of {0} bytes is longer than the limit of {MAX_MESSAGE_BYTES}")]
    TooLong(usize),
    /// Not this kind of message, or not of this version.
    #[error("the message cannot be read: {0}")]
    Malformed(String),
    /// Something follows.
    #[error("{0} bytes follow the message")]
    Trailing(usize),
}

/// What travels as a frame: [`ToAggregator`] and [`ToAgent`].
pub trait Message: Serialize + DeserializeOwned {}

impl Message for ToAggregator {}
impl Message for ToAgent {}

/// Which batch a frame holds: readable even when an event in it is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchHead {
    /// Whose.
    pub host: HostId,
    /// Which stream.
    pub stream: StreamId,
    /// Contiguous from 1.
    pub number: u64,
}

/// The frame of a message.
pub fn encode(message: &impl Message) -> Vec<u8> {
    let mut frame = Vec::with_capacity(256);
    append(&mut frame, message);
    frame
}

/// Appends the wire form of plain data.
pub(super) fn append(out: &mut Vec<u8>, data: &impl Serialize) {
    rmp_serde::encode::write(out, data).expect("plain data written to memory always serialises");
}

/// Reads a frame that anyone may have sent.
///
/// # Errors
/// When it is not exactly one message of this kind within the limits.
pub fn decode<M: Message>(frame: &[u8]) -> Result<M, CodecError> {
    if frame.len() > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(frame.len()));
    }
    let mut reader = rmp_serde::Deserializer::new(frame);
    reader.set_max_depth(MAX_NESTING);
    let message = M::deserialize(&mut reader).map_err(|error| CodecError::Malformed(error.to_string()))?;
    match reader.get_ref().len() {
        0 => Ok(message),
        more => Err(CodecError::Trailing(more)),
    }
}

/// The head of a batch's frame; `None` for any other message. What follows the head is not looked at: a batch
/// that [`decode()`] refuses can still be named, recorded as missing, and left behind.
pub fn batch_head(frame: &[u8]) -> Option<BatchHead> {
    read_head(frame).map(|(head, _)| head)
}

/// How many events a batch's frame claims to hold, if it can hold so many; `None` when that cannot be read.
pub fn batch_events(frame: &[u8]) -> Option<u64> {
    let (_, mut rest) = read_head(frame)?;
    let events = decode::read_array_len(&mut rest).ok()?;
    // Each takes a byte at least.
    (events as usize <= rest.len()).then_some(u64::from(events))
}

/// The head, and what follows it.
fn read_head(frame: &[u8]) -> Option<(BatchHead, &[u8])> {
    let mut rest = frame;
    let variants = decode::read_map_len(&mut rest).ok()?;
    let name = decode::read_str_len(&mut rest).ok()? as usize;
    let (name, mut rest) = rest.split_at_checked(name)?;
    if variants != 1 || name != BATCH.as_bytes() || decode::read_array_len(&mut rest).ok()? != 4 {
        return None;
    }
    let mut id = || {
        (decode::read_bin_len(&mut rest).ok()? == 16).then_some(())?;
        let (id, after) = rest.split_first_chunk::<16>()?;
        rest = after;
        Some(*id)
    };
    let (host, stream) = (HostId::from_bytes(id()?), StreamId::from_bytes(id()?));
    let number = decode::read_int(&mut rest).ok()?;
    Some((BatchHead { host, stream, number }, rest))
}

/// The frame of a batch of events that are encoded already: what [`encode`] makes of the [`super::Batch`].
pub(super) fn batch_frame(head: BatchHead, events: u32, body: &[u8]) -> Vec<u8> {
    let mut frame = Vec::with_capacity(body.len() + 64);
    write_batch(&mut frame, head, events, body).expect("a vector takes all bytes");
    frame
}

fn write_batch(
    frame: &mut Vec<u8>,
    head: BatchHead,
    events: u32,
    body: &[u8],
) -> Result<(), put::ValueWriteError> {
    put::write_map_len(frame, 1)?;
    put::write_str(frame, BATCH)?;
    put::write_array_len(frame, 4)?;
    put::write_bin(frame, head.host.as_bytes())?;
    put::write_bin(frame, head.stream.as_bytes())?;
    put::write_uint(frame, head.number)?;
    put::write_array_len(frame, events)?;
    frame.write_all(body).map_err(put::ValueWriteError::InvalidDataWrite)
}

#[cfg(test)]
mod tests {
    use peernet_clock::{
        DelaySource, Discipline, Exchange, ExchangeCounts, Interval, Offset, RehearsalDescription,
        RehearsedStep, Span, Verdict, WallTime,
    };
    use proptest::prelude::*;

    use super::super::{
        Accounting, Batch, ClockSample, DelayPoint, DelaySecond, Event, HostClock, HostMetrics, Incident,
        IncidentKind, LinkLive, LiveUpdate, ProbeCounts, Probing, RoundTrip,
    };
    use super::*;

    fn interval(lo: i64, hi: i64) -> Interval {
        Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) }
    }

    /// A sample with everything that one can hold.
    fn clock() -> ClockSample {
        let at = WallTime::from_unix_nanos;
        let exchange = Exchange {
            sent: at(1_000),
            received: at(-2_000),
            replied: at(-1_500),
            returned: at(4_000),
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
            window: u64::MAX,
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
            probes: ProbeCounts { sent: 10, answered: 9, lost: 1 },
            exchanges: ExchangeCounts { taken: 9, impossible: 1, outliers: 2, stepped: 3, restarts: 4 },
            round_trip: Some(RoundTrip { min: Span::from_micros(2), median: Span::from_micros(3) }),
            up: Some(delays),
            down: Some(DelaySecond { median: None, ..delays }),
        }
    }

    fn host_clock() -> HostClock {
        HostClock {
            discipline: Some(Discipline { source: DelaySource::Chrony, error: interval(-7, 7) }),
            text: "chrony, stratum 2, to 10.0.0.1".into(),
            epoch: 3,
            rehearsal: Some(RehearsalDescription {
                offset: Span::from_seconds(1),
                drift_ppm: -50.0,
                steps: vec![RehearsedStep { at: Span::from_seconds(9), by: Span::from_seconds(-3) }],
                since: WallTime::from_unix_nanos(5),
            }),
        }
    }

    fn batch(number: u64, events: usize) -> Batch {
        let incident = Incident {
            at: WallTime::from_unix_nanos(7),
            kind: IncidentKind::Connected,
            pipeline: Some("line".parse().expect("a name")),
            run: None,
            peer: Some(HostId::random()),
            text: "back after 2 s".into(),
        };
        let kinds = [Event::Incident(incident), Event::Clock(Box::new(clock()))];
        let events = kinds.into_iter().cycle().take(events).collect();
        Batch { host: HostId::random(), stream: StreamId::random(), number, events }
    }

    fn frame_of(batch: &Batch) -> Vec<u8> {
        let mut body = Vec::new();
        batch.events.iter().for_each(|event| append(&mut body, event));
        let head = BatchHead { host: batch.host, stream: batch.stream, number: batch.number };
        batch_frame(head, batch.events.len() as u32, &body)
    }

    #[test]
    fn a_frame_of_encoded_events_is_the_frame_of_the_batch() {
        for (number, events) in [(1, 0), (300, 1), (70_000, 40), (u64::MAX, 70_000)] {
            let batch = batch(number, events);
            let frame = frame_of(&batch);
            let head = BatchHead { host: batch.host, stream: batch.stream, number };
            assert_eq!(batch_head(&frame), Some(head));
            if frame.len() <= MAX_MESSAGE_BYTES {
                assert_eq!(decode(&frame), Ok(ToAggregator::Batch(batch.clone())));
            }
            assert!(frame == encode(&ToAggregator::Batch(batch)));
        }
    }

    #[test]
    fn what_is_told_of_clocks_arrives_as_it_was_sent() {
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
            now: clock(),
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
    fn a_batch_with_an_unreadable_event_can_still_be_named() {
        let batch = batch(5, 2);
        let mut frame = frame_of(&batch);
        frame.truncate(frame.len() - 1);
        assert!(decode::<ToAggregator>(&frame).is_err());
        assert_eq!(batch_head(&frame).map(|head| head.number), Some(5));
        assert_eq!(batch_events(&frame), Some(2));
        assert_eq!(batch_events(&frame[..frame.len() / 8]), None);
        assert_eq!(batch_head(&encode(&ToAggregator::Goodbye(batch.host))), None);
    }

    #[test]
    fn limits_and_remainders_are_refused() {
        let frame = encode(&ToAgent::Unknown);
        assert_eq!(decode(&frame), Ok(ToAgent::Unknown));
        assert_eq!(decode::<ToAgent>(&[&frame[..], &[0]].concat()), Err(CodecError::Trailing(1)));
        let long = vec![0; MAX_MESSAGE_BYTES + 1];
        assert_eq!(decode::<ToAgent>(&long), Err(CodecError::TooLong(long.len())));
        let deep = vec![0x91; 100_000];
        assert!(matches!(decode::<ToAggregator>(&deep), Err(CodecError::Malformed(_))));
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes: Vec<u8>) {
            let _ = (decode::<ToAggregator>(&bytes), decode::<ToAgent>(&bytes), batch_events(&bytes));
        }

        #[test]
        fn no_damage_panics(at: prop::sample::Index, byte: u8, cut: prop::sample::Index) {
            let mut frame = frame_of(&batch(5, 2));
            let at = at.index(frame.len());
            frame[at] = byte;
            let _ = (decode::<ToAggregator>(&frame), batch_head(&frame));
            let _ = (decode::<ToAggregator>(&frame[..cut.index(at + 1)]), batch_head(&frame[..at]));
        }
    }
}
