//! Clock samples of a pipeline: the edge's relation to the rack's clock, once a second.

use peernet_clock::{
    ClockClaim, ClockFaults, DelaySource, Exchange, ExchangeCounts, Interval, Offset, RawTime, RelatedClocks,
    Span, Verdict, WallTime,
};
use peernet_logger::{HostId, stage};
use peernet_statistics::SplitMix64;
use peernet_stream::{
    ClockSample, Connection, ConnectionStatistics, DelayPoint, DelaySecond, DirectionStatistics,
    EstimateBasis, HostClock, LinkLive, NetworkInterface, NetworkName, ProbeCounts, Probing, RoundTrip,
    TransportRoundTrip,
};

use super::pipeline::ANSWER_BYTES;
use super::{Clocks, TestPipeline, slug};

/// The rack's wall clock minus a camera's, middle of the reported bounds.
pub(super) const AHEAD: Span = Span::from_micros(1_204_180);
/// Rate at which the offset [`AHEAD`] grows.
const SKEW_PPM: f64 = 12.4;

fn seconds(seconds: f64) -> Span {
    Span::from_seconds_f64(seconds)
}

/// Returns a host's report on its clock.
pub(super) fn host_clock(has_clock_fault: bool, since: WallTime) -> HostClock {
    let claim = Interval { lo: seconds(-0.0018), hi: seconds(0.0021) };
    HostClock {
        claim: Some(ClockClaim { source: DelaySource::Chrony, error: claim }),
        text: "chrony, stratum 3, to ntp.plant".into(),
        epoch: u32::from(has_clock_fault),
        faults: has_clock_fault.then(|| ClockFaults {
            offset: Span::from_seconds(1),
            drift_ppm: 50.0,
            steps: Vec::new(),
            since,
        }),
        clocksource: Some(if has_clock_fault { "kvm-clock" } else { "tsc" }.to_owned()),
    }
}

/// Returns the delays of data in one direction within a second.
fn delays(pipeline: &TestPipeline, name: &str, random: &mut SplitMix64) -> DelaySecond {
    let mean =
        pipeline.stages.iter().find(|(known, ..)| known == name).map_or(0.001, |(_, mean, _)| mean / 1e3);
    let value = mean * (1.0 + 0.03 * random.normal());
    let bound = match pipeline.clocks {
        Clocks::Within(bound) => bound,
        Clocks::Shared | Clocks::Unrelated => 0.0,
    };
    let bytes = if name == stage::UPLOAD.as_str() { pipeline.bytes } else { ANSWER_BYTES };
    let is_known = pipeline.clocks != Clocks::Unrelated;
    DelaySecond {
        count: pipeline.hz as u32,
        median: is_known.then(|| DelayPoint {
            value: seconds(value),
            bounds: Interval { lo: seconds((value - bound).max(0.0)), hi: seconds(value + bound) },
            bits_per_second: Some(bytes * 8.0 / value),
        }),
        verdict: Verdict::from_name(pipeline.verdict(&name.to_owned().into())).expect("a verdict"),
    }
}

/// Returns the clock sample at the last full second up to `at`. The sample is `ago` seconds older than the newest
/// sample.
pub(super) fn sample(
    pipeline: &TestPipeline,
    rack: HostId,
    at: WallTime,
    ago: i64,
    random: &mut SplitMix64,
) -> ClockSample {
    let at = WallTime::from_unix_nanos(at.unix_seconds() * 1_000_000_000);
    let bound = match pipeline.clocks {
        Clocks::Within(bound) => Some(bound),
        Clocks::Shared => Some(0.0),
        Clocks::Unrelated => None,
    };
    // The network was slow for 35 seconds. A clock was stepped a minute ago, and the bounds were wider for a few
    // seconds after the step.
    let slowdown = if (140..175).contains(&ago) { 1.9 } else { 1.0 };
    let (relation_period, stepped) = if ago > 60 { (11, seconds(-0.0182)) } else { (12, Span::ZERO) };
    let truth = if pipeline.clocks == Clocks::Shared {
        Span::ZERO
    } else {
        AHEAD + stepped - seconds(SKEW_PPM * 1e-6 * ago as f64)
    };
    let widening = if (55..=60).contains(&ago) { 2.5 } else { 1.0 };
    let offset = bound.map(|bound| {
        let half = bound * slowdown * widening * (1.0 + 0.04 * random.unit());
        let estimate = truth + seconds(bound * 0.08 * random.normal());
        let bounds = Interval { lo: truth - seconds(half), hi: truth + seconds(half) };
        let claimed = Interval { lo: truth - seconds(0.0039), hi: truth + seconds(0.0037) };
        let shared = pipeline.clocks == Clocks::Shared;
        Offset {
            at,
            estimate: if shared { Span::ZERO } else { estimate.clamp(bounds.lo, bounds.hi) },
            bounds,
            source: if shared { DelaySource::SameClock } else { DelaySource::Intersection },
            sources: if shared {
                vec![(DelaySource::SameClock, bounds)]
            } else {
                vec![(DelaySource::InBand, bounds), (DelaySource::Chrony, claimed)]
            },
            verdict: Verdict::Ok,
            skew_ppm: (!shared).then_some(SKEW_PPM),
            exchanges: 6_120,
            age: Some(seconds(0.04)),
        }
    });
    let trip = bound.filter(|bound| *bound > 0.0).map(|bound| {
        let min = 2.0 * bound * slowdown * (1.0 + 0.01 * random.unit());
        RoundTrip { min: seconds(min), median: seconds(min * (1.3 + 0.1 * random.unit())) }
    });
    let exchange = trip.map(|trip| {
        let way = seconds(trip.min.seconds() / 2.0);
        let received = at + truth + way;
        let replied = received + Span::from_micros(30);
        Exchange {
            sent: RawTime::from_wall(at),
            received: RawTime::from_wall(received),
            replied: RawTime::from_wall(replied),
            returned: RawTime::from_wall(at + way + way + Span::from_micros(30)),
            uncertainty: Span::from_nanos(300),
        }
    });
    let lost = u32::from(trip.is_some() && (ago % 47 == 0 || (slowdown > 1.0 && ago % 3 == 0)));
    let sent = if trip.is_some() { 10 } else { 0 };
    ClockSample {
        peer: rack,
        peer_name: slug("rack-a"),
        at,
        relation_period,
        max_drift_ppm: 50.0,
        upper: exchange,
        lower: exchange,
        offset,
        probes: ProbeCounts { sent, answered: sent - lost, lost, refused: 0 },
        exchanges: match pipeline.clocks {
            Clocks::Unrelated => ExchangeCounts::default(),
            _ => ExchangeCounts { accepted: 61_207, impossible: 2, outliers: 5, stepped: 3, restarts: 1 },
        },
        round_trip: trip,
        up: Some(delays(pipeline, "upload", random)),
        down: Some(delays(pipeline, "download", random)),
        network: NetworkName::default(),
        basis: bound.filter(|bound| *bound > 0.0).map(|_| EstimateBasis {
            clocks: RelatedClocks::Wall,
            proven_skew_ppm: Some((SKEW_PPM - 2.0, SKEW_PPM + 2.0)),
            claims_trusted: true,
            probes_authenticated: Some(false),
            ..EstimateBasis::default()
        }),
    }
}

/// Returns the connection of a pipeline: an upload of 10 MB a second since the Unix epoch.
fn connection(pipeline: &str, at: WallTime) -> Connection {
    let seconds = at.unix_seconds().unsigned_abs();
    let sent = DirectionStatistics {
        bytes: seconds * 10_000_000,
        messages: seconds * 30,
        datagrams: Some(seconds * 7_000),
        duplicated: Some(0),
        reordered: Some(4),
        retransmitted: Some(17),
        lost: None,
    };
    let received = DirectionStatistics {
        bytes: seconds * 9_000,
        messages: seconds * 30,
        datagrams: Some(seconds * 30),
        reordered: Some(0),
        ..DirectionStatistics::default()
    };
    Connection {
        pipeline: slug(pipeline),
        network: NetworkName::default(),
        local: Some("192.0.2.7:40112".into()),
        remote: Some("192.0.2.5:5551".into()),
        interface: Some(NetworkInterface {
            name: "wlan0".into(),
            kind: Some("wireless".into()),
            mtu_bytes: Some(1_500),
        }),
        statistics: ConnectionStatistics {
            sent,
            received,
            round_trip: Some(TransportRoundTrip {
                min: Some(Span::from_micros(1_080)),
                smoothed: Span::from_micros(2_310),
                variation: Span::from_micros(140),
            }),
            ..ConnectionStatistics::default()
        },
        cloud: Some(ConnectionStatistics {
            sent: received,
            received: DirectionStatistics { retransmitted: None, ..sent },
            ..ConnectionStatistics::default()
        }),
    }
}

/// Returns the link of a pipeline, as its edge reports it.
pub(super) fn live(pipeline: &TestPipeline, latest_sample: ClockSample) -> LinkLive {
    let probing = match pipeline.clocks {
        Clocks::Within(_) => Probing::On {
            address: "udp://192.0.2.5:8620".into(),
            rate_hz: 10.0,
            stamps: "kernel, receive only".into(),
        },
        Clocks::Shared => Probing::Off("both hosts read one clock: nothing to find out".into()),
        Clocks::Unrelated => Probing::Unanswered { address: "udp://192.0.2.5:8620".into(), reason: None },
    };
    let clock = host_clock(pipeline.has_clock_fault, latest_sample.at);
    LinkLive {
        peer: latest_sample.peer,
        peer_name: latest_sample.peer_name.clone(),
        networks: vec!["zmq-tcp".into()],
        pipelines: vec![slug(pipeline.name)],
        same_clock: pipeline.clocks == Clocks::Shared,
        probing,
        edge: Some(clock),
        cloud: Some(host_clock(false, latest_sample.at)),
        connections: vec![connection(pipeline.name, latest_sample.at)],
        reflector: None,
        latest_sample,
    }
}
