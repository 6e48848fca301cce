//! Proptest strategies for messages.

use peernet_clock::{
    ClockClaim, ClockFaultStep, ClockFaults, ClockIdentity, DelaySource, Interval, RawTime, Span, WallTime,
};
use peernet_logger::{HostId, Slug};
use peernet_sample::{Description, ElementType, MediaType, PixelFormat};
use peernet_stream::{
    Condition, ConnectionStatistics, DirectionStatistics, Grade, Hardware, Release, VersionRange,
};
use proptest::prelude::*;

use super::{
    Accepted, Cancel, ClockSocketName, ClockUpdate, Departure, Goodbye, Header, Open, Outcome,
    PartialAnswersRead, PartialReply, PeerClock, ProbeKey, RawClock, RefusalKind, Refused, Reply, Request,
    SampleHeader, SessionAccepted, SessionHello, SessionId, StatisticsReport, UnknownSession,
};

fn slug() -> impl Strategy<Value = Slug> {
    "[a-z0-9][a-z0-9._-]{0,20}".prop_map(|name| name.parse().expect("a name"))
}

fn host() -> impl Strategy<Value = HostId> {
    any::<[u8; 16]>().prop_map(HostId::from_bytes)
}

fn clock() -> impl Strategy<Value = ClockIdentity> {
    (".{0,40}", ".{0,10}", any::<Option<u64>>())
        .prop_map(|(boot, clock, process)| ClockIdentity { process, ..ClockIdentity::new(&boot, &clock) })
}

pub(crate) fn hello() -> impl Strategy<Value = SessionHello> {
    let device = proptest::option::of(printable_text());
    let socket = any::<Option<[u8; ClockSocketName::BYTES]>>();
    (versions(), host(), slug(), clock(), slug(), proptest::option::of(slug()), device, socket).prop_map(
        |(versions, host, name, clock, pipeline, model, device, socket)| SessionHello {
            versions,
            host,
            name,
            clock,
            pipeline,
            model,
            device,
            clock_socket: socket.map(ClockSocketName::new),
        },
    )
}

fn versions() -> impl Strategy<Value = VersionRange> {
    let range = any::<(u16, u16, u16)>()
        .prop_map(|(oldest, newest, minor)| VersionRange::new(oldest, newest, Release(0, minor, 0)));
    prop_oneof![any::<u16>().prop_map(VersionRange::single), range]
}

fn span() -> impl Strategy<Value = Span> {
    any::<i64>().prop_map(Span::from_nanos)
}

fn claim() -> impl Strategy<Value = ClockClaim> {
    let source = prop_oneof![Just(DelaySource::Kernel), Just(DelaySource::Chrony)];
    (source, span(), span()).prop_map(|(source, a, b)| {
        let error = Interval { lo: a.min(b), hi: a.max(b) };
        ClockClaim { source, error }
    })
}

fn faults() -> impl Strategy<Value = ClockFaults> {
    let step = (span(), span()).prop_map(|(at, by)| ClockFaultStep::wall_step(at, by));
    let steps = proptest::collection::vec(step, 0..3);
    (span(), -1e3..1e3_f64, steps, any::<i64>()).prop_map(|(offset, drift_ppm, steps, since)| ClockFaults {
        offset,
        drift_ppm,
        steps,
        since: WallTime::from_unix_nanos(since),
    })
}

pub(crate) fn peer_clock() -> impl Strategy<Value = PeerClock> {
    let (claim, faults) = (proptest::option::of(claim()), proptest::option::of(faults()));
    (any::<u32>(), claim, printable_text(), faults, proptest::option::of(raw_clock()))
        .prop_map(|(epoch, claim, text, faults, raw)| PeerClock { epoch, claim, text, faults, raw })
}

fn raw_clock() -> impl Strategy<Value = RawClock> {
    (any::<u32>(), span(), span(), printable_text()).prop_map(|(epoch, a, b, clocksource)| {
        let wall_ahead = Interval { lo: a.min(b), hi: a.max(b) };
        RawClock { epoch, wall_ahead, clocksource }
    })
}

pub(crate) fn accepted() -> impl Strategy<Value = SessionAccepted> {
    let facts = proptest::collection::vec((printable_text(), printable_text()), 0..4);
    let clocks = (clock(), peer_clock(), any::<(Option<u16>, u64, Option<[u8; 32]>)>());
    let conditions = proptest::collection::vec(condition(), 0..4);
    let texts = (printable_text(), printable_text(), facts, conditions, hardware());
    (host(), slug(), clocks, slug(), texts).prop_map(
        |(host, name, (clock, host_clock, (probes, instance, key)), model, texts)| {
            let (version, device, facts, conditions, hardware) = texts;
            SessionAccepted {
                host,
                name,
                clock,
                version,
                model,
                device,
                facts,
                host_clock,
                probes,
                instance,
                probe_key: key.map(ProbeKey::new),
                conditions,
                hardware,
            }
        },
    )
}

fn hardware() -> impl Strategy<Value = Hardware> {
    let gpus = proptest::collection::vec(printable_text(), 0..3);
    (printable_text(), any::<(u32, u64)>(), gpus, printable_text(), printable_text()).prop_map(
        |(cpu, (cores, memory_bytes), gpus, system, architecture)| Hardware {
            cpu,
            cores,
            memory_bytes,
            gpus,
            system,
            architecture,
        },
    )
}

fn condition() -> impl Strategy<Value = Condition> {
    let grade = prop_oneof![Just(Grade::Good), Just(Grade::Unknown), Just(Grade::Doubtful), Just(Grade::Bad)];
    (printable_text(), printable_text(), printable_text(), grade, printable_text())
        .prop_map(|(host, about, found, grade, advice)| Condition { host, about, found, grade, advice })
}

fn description() -> impl Strategy<Value = Description> {
    let media = prop_oneof![
        Just(MediaType::Bytes),
        Just(MediaType::Jpeg),
        Just(MediaType::Pixels(PixelFormat::Grey8)),
        Just(MediaType::Tensor),
        ".{0,20}".prop_map(MediaType::Other),
    ];
    let element = prop_oneof![Just(None), Just(Some(ElementType::U8)), Just(Some(ElementType::F64))];
    let shape = proptest::collection::vec(any::<u32>(), 0..5);
    (media, shape, element).prop_map(|(media, shape, element)| Description { media, shape, element })
}

fn sample() -> impl Strategy<Value = SampleHeader> {
    (proptest::collection::vec(description(), 0..5), ".{0,30}", proptest::option::of(".{0,30}"))
        .prop_map(|(parts, source, label)| SampleHeader { parts, source, label })
}

fn departure() -> impl Strategy<Value = Departure> {
    (any::<i64>(), span(), any::<u32>(), raw_time()).prop_map(|(sent, sent_since_anchor, epoch, sent_raw)| {
        Departure { sent: WallTime::from_unix_nanos(sent), sent_since_anchor, epoch, sent_raw }
    })
}

fn raw_time() -> impl Strategy<Value = Option<RawTime>> {
    proptest::option::of(any::<i64>().prop_map(RawTime::from_nanos))
}

/// Returns texts without control characters and line separators. Decoding would replace these characters.
fn printable_text() -> impl Strategy<Value = String> {
    "[^\\pC\\p{Zl}\\p{Zp}]{0,30}"
}

fn outcome() -> impl Strategy<Value = Outcome> {
    prop_oneof![
        sample().prop_map(Outcome::Answer),
        printable_text().prop_map(Outcome::Failed),
        printable_text().prop_map(Outcome::Overloaded),
    ]
}

/// Returns the header of any message of one of the given sessions, or of a session with a random id if none is given.
/// Request numbers are 0 to 15.
pub(crate) fn header(sessions: Vec<SessionId>) -> impl Strategy<Value = Header> {
    let session = any::<prop::sample::Index>()
        .prop_map(move |index| if sessions.is_empty() { SessionId::random() } else { *index.get(&sessions) });
    let request = 0..16_u64;
    let kind = prop_oneof![Just(RefusalKind::Refused), Just(RefusalKind::Incompatible)];
    let request_fields = (session, request, departure());
    (
        request_fields,
        sample(),
        proptest::option::of(departure()),
        outcome(),
        (hello(), accepted(), peer_clock()),
        (kind, printable_text(), any::<u64>(), any::<Option<u64>>(), raw_time()),
    )
        .prop_flat_map(
            |((session, request, departure), sample, reply_departure, outcome, (hello, accepted, clock), other_fields)| {
                let (kind, reason, max_message_bytes, planned_iterations, arrived_raw) = other_fields;
                // Some random values serve for several fields.
                let (versions, arrival_epoch) = (hello.versions, clock.epoch);
                let (number, partial_answer) = (arrival_epoch, sample.clone());
                let protocol = versions.oldest();
                // An empty reason is rare, so `lost` is `None` in most headers.
                let lost = planned_iterations.filter(|_| reason.is_empty());
                let sent = DirectionStatistics { bytes: max_message_bytes, lost, ..DirectionStatistics::default() };
                let statistics = ConnectionStatistics { sent, ..ConnectionStatistics::default() };
                prop_oneof![
                    1 => Just(Header::Open(Box::new(Open { hello, max_message_bytes }))),
                    1 => Just(Header::Accepted(Box::new(Accepted {
                        protocol,
                        session,
                        accepted,
                        max_message_bytes,
                        max_in_flight: 7,
                    }))),
                    1 => Just(Header::Refused(Refused { versions, kind, reason: reason.clone() })),
                    4 => Just(Header::Request(Request { session, request, departure, sample })),
                    4 => Just(Header::Reply(Reply { session, request, departure: reply_departure, arrival_epoch, outcome, arrived_raw })),
                    2 => Just(Header::PartialReply(PartialReply { session, request, part: number, departure, sample: partial_answer })),
                    1 => Just(Header::PartialAnswersRead(PartialAnswersRead { session, request, read_count: number })),
                    1 => Just(Header::Cancel(Cancel { session, request })),
                    1 => Just(Header::Clock(Box::new(ClockUpdate { session, clock }))),
                    1 => Just(Header::Statistics(Box::new(StatisticsReport { session, statistics }))),
                    1 => Just(Header::UnknownSession(UnknownSession { session, request })),
                    1 => Just(Header::Goodbye(Goodbye { session, reason, planned_iterations })),
                ]
            },
        )
}
