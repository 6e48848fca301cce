//! Example data of the aggregator, from which tests render every page in every state.

use std::sync::Arc;

use peernet_aggregator::{
    Aggregator, AggregatorConfig, HostSnapshot, LinkSnapshot, LiveSecond, LiveState, MetricsPoint,
    PercentilePoint, PercentileSeries, PipelineSnapshot, RefusedHost, RejectedBatches, Totals, Window,
};
use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::rows::Outcome;
use peernet_analysis::transfer::Transfers;
use peernet_clock::{
    ClockIdentity, DelaySource, ExchangeCounts, Interval, ManualClock, Offset, Span, Verdict, WallTime,
};
use peernet_logger::{Anchor, HostId, Name, Slug, Tree, stage};
use peernet_store::{
    ClockPoint, DelayAccuracy, IncidentRow, IterationDetail, IterationRow, QuantityStatistics, StoredCounts,
};
use peernet_stream::{
    Accounting, ClockSample, Connection, ConnectionStatistics, DelayPoint, DelaySecond, DirectionStatistics,
    Hardware, HostClock, HostDescription, HostMetrics, LinkLive, NetworkInterface, NetworkName,
    OutcomeCounts, PipelineState, Placement, PlacementKind, ProbeCounts, Probing, RoundTrip,
    TransportRoundTrip,
};
use tokio_util::sync::CancellationToken;

use crate::config::WebConfig;
use crate::state::{App, AppState};
use crate::zone::Zone;

/// 19 Nov 2026, 12:01:07.4 UTC.
pub(crate) const NOW: WallTime = WallTime::from_unix_nanos(1_795_089_667_400_000_000);

/// Text that would run a script if it were not escaped.
pub(crate) const HOSTILE: &str = "</script><script>alert(1)</script>\" onmouseover=\"alert(2)' & <b>";

pub(crate) fn slug(text: &str) -> Slug {
    text.parse().expect("a name")
}

/// Returns the state of the handlers, with a real aggregator on an empty database in the returned folder.
pub(crate) async fn app() -> (App, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let clock = Arc::new(ManualClock::new(NOW, ClockIdentity::new("boot", "system")));
    let config = AggregatorConfig {
        name: Some(slug("rack-a")),
        listen: "tcp://127.0.0.1:0".into(),
        database: folder.path().join("store.sqlite"),
        ..AggregatorConfig::default()
    };
    let stop = CancellationToken::new();
    let running = Aggregator::start(config, clock.clone(), stop.clone()).await.expect("starts");
    let config = WebConfig { time_zone: Zone::Utc, ..WebConfig::default() };
    (AppState::new(&config, running.handle, clock, stop), folder)
}

/// Returns the statistics of `count` values with this mean. Quantiles are present if there are enough values.
pub(crate) fn figures(mean: f64, count: u64) -> QuantityStatistics {
    QuantityStatistics {
        count,
        mean,
        std: (count > 1).then_some(mean * 0.07),
        min: mean * 0.9,
        p50: mean,
        p95: (count >= 60).then_some(mean * 1.1),
        p99: (count >= 300).then_some(mean * 1.3),
        max: mean * 2.0,
    }
}

/// Means of the stages of an offloading pipeline, seconds.
const MEANS: [(&str, f64); 11] = [
    ("sensing", 0.0047),
    ("encode", 0.0001),
    ("upload", 0.0063),
    ("queue", 0.00004),
    ("preprocessing", 0.0003),
    ("inference", 0.0035),
    ("postprocessing", 0.0002),
    ("download", 0.0006),
    ("actuation", 0.0002),
    ("total", 0.01604),
    ("unattributed", 0.0001),
];

/// Returns the transfers of `messages` uploads of 150 kB each, without downloads. Each upload takes `upload` seconds;
/// `None` for an unknown delay.
fn transfers(messages: u64, upload: Option<f64>) -> Transfers {
    Transfers::from_statistics(|name| match name.as_str() {
        "upload-bytes" => (messages > 0).then_some((messages, 149_625.0)),
        "upload" => Some((messages, upload?)),
        _ => None,
    })
}

/// Half the width of the clock bounds, seconds.
const HALF_WIDTH: f64 = 0.00065;

/// Returns a window of `seconds` seconds with `hz` iterations per second. Its means are `scale` times [`MEANS`]. All
/// delays have the verdict `verdict`; delays that are `Unsynchronised` have no values.
pub(crate) fn window(seconds: u32, hz: f64, scale: f64, verdict: Verdict) -> Window {
    let successes = (f64::from(seconds) * hz) as u64;
    let is_transit = |name: &str| matches!(name, "upload" | "download");
    let is_delay_known = verdict != Verdict::Unsynchronised;
    let values = MEANS.iter().filter(|(name, _)| successes > 0 && (is_delay_known || !is_transit(name)));
    let mut values: Vec<(Name, QuantityStatistics)> =
        values.map(|(name, mean)| (Name::from(*name), figures(mean * scale, successes))).collect();
    if is_delay_known && successes > 0 {
        values.push((stage::UPLOAD_THROUGHPUT, figures(1.9e8 / scale, successes)));
    }
    let bounds = [stage::UPLOAD, stage::DOWNLOAD].map(|stage| {
        let delay = values.iter().find(|(name, _)| *name == stage).map(|(_, delay)| delay.mean);
        DelayAccuracy {
            half_width: is_delay_known.then(|| figures(HALF_WIDTH, successes.max(1))),
            ends: delay.map(|delay| {
                [delay - HALF_WIDTH, delay + HALF_WIDTH].map(|end| figures(end, successes.max(1)))
            }),
            verdicts: vec![(verdict, successes)],
            stage,
        }
    });
    Window {
        seconds,
        covered_s: f64::from(seconds),
        counts: OutcomeCounts { ok: successes, ..OutcomeCounts::default() },
        rate_hz: hz,
        failed_fraction: (successes > 0).then_some(0.0),
        miss_rate: None,
        transfers: transfers(successes, (is_delay_known && successes > 0).then_some(0.0063 * scale)),
        values,
        bounds: bounds.to_vec(),
    }
}

pub(crate) fn placement(kind: PlacementKind) -> Placement {
    let remote = kind == PlacementKind::Remote;
    Placement {
        kind,
        peer: remote.then(|| slug("rack-a")),
        network: remote.then(|| "zmq-tcp".into()),
        address: remote.then(|| "tcp://192.0.2.5:5551".into()),
        model: slug("quality-control"),
        device: Some("cpu".into()),
    }
}

/// Returns a pipeline with a series of two minutes. The series lacks the seconds whose ages, in seconds, are in `gaps`.
pub(crate) fn pipeline(name: &str, hz: f64, scale: f64, verdict: Verdict, gaps: &[i64]) -> PipelineSnapshot {
    let last = NOW.unix_seconds();
    let series = (last - 120..=last).filter(|at| !gaps.contains(&(last - at)));
    let series = series.map(|at| {
        let means: Vec<(Name, f64)> =
            MEANS.iter().map(|(name, mean)| (Name::from(*name), mean * scale)).collect();
        let is_part = |(name, _): &&(Name, f64)| stage::ORDER.contains(name) || *name == stage::UNATTRIBUTED;
        let parts = means.iter().filter(is_part).cloned().collect();
        let counts = OutcomeCounts { ok: hz as u64, ..OutcomeCounts::default() };
        let mut verdicts = VerdictCounts::default();
        verdicts.add(verdict, counts.ok);
        Arc::new(LiveSecond {
            at,
            counts,
            means,
            parts,
            total_p95: (counts.ok >= 60).then_some(0.018 * scale),
            transfers: transfers(counts.ok, Some(0.0063 * scale)),
            verdicts: [verdicts; 2],
        })
    });
    PipelineSnapshot {
        host: host_id(),
        host_name: slug("cam-1"),
        pipeline: slug(name),
        state: PipelineState::Running,
        run: None,
        run_number: Some(412),
        placement: placement(PlacementKind::Remote),
        load: format!("{hz} Hz"),
        last_seen: NOW,
        windows: [1, 10, 60].map(|seconds| window(seconds, hz, scale, verdict)),
        series: series.collect(),
        total_p95: percentiles(last, hz, scale),
    }
}

/// Returns the percentiles of the last two minutes in buckets of 10 s; no percentiles if a bucket has less than 60
/// iterations.
fn percentiles(last: i64, hz: f64, scale: f64) -> PercentileSeries {
    let count = 10 * hz as u64;
    if count < 60 {
        return PercentileSeries::default();
    }
    let bucket_starts = (last - 120..=last).filter(|at| at % 10 == 0);
    let points = bucket_starts.map(|at| PercentilePoint { at, count, p95: 0.018 * scale });
    PercentileSeries { bucket_s: Some(10), points: points.collect() }
}

fn host_id() -> HostId {
    HostId::from_bytes([7; 16])
}

/// Returns a connected host. `hardware` is both the name of its processor and the version of its agent.
pub(crate) fn host(name: &str, hardware: &str) -> HostSnapshot {
    let metrics =
        HostMetrics { cpu: Some(0.31), memory_used_bytes: Some(4_100_000_000), ..HostMetrics::default() };
    HostSnapshot {
        id: host_id(),
        description: HostDescription {
            id: host_id(),
            name: slug(name),
            clock: ClockIdentity::new("boot", "system"),
            version: hardware.to_owned(),
            hardware: Hardware {
                cpu: hardware.to_owned(),
                memory_bytes: 16_000_000_000,
                ..Hardware::default()
            },
            serves: None,
            models: Vec::new(),
        },
        connected: true,
        has_left: false,
        last_seen: NOW,
        clock_ahead: Span::from_millis(3),
        behind: None,
        catching_up: None,
        clock: HostClock::default(),
        history: vec![Arc::new(MetricsPoint { at: NOW, metrics: metrics.clone() })],
        metrics,
        accounting: Accounting::default(),
        stored: StoredCounts::default(),
        rejected_batches: RejectedBatches::default(),
        newest_stored: None,
        live_left_out: 0,
    }
}

/// Returns event counts that add up. Some events wait, and some were dropped.
pub(crate) fn accounting() -> Accounting {
    Accounting {
        produced: 1_204_500,
        spooled: 1_204_370,
        sent: 1_203_000,
        stored: 1_202_988,
        waiting: 1_462,
        dropped: 50,
        gaps: 1,
        spool_bytes: 312_000_000,
        spool_limit_bytes: 1 << 30,
        memory_bytes: 21_200,
        oldest: Some(NOW - Span::from_millis(400)),
        compressed: false,
        trouble: None,
    }
}

pub(crate) fn snapshot(hosts: Vec<HostSnapshot>, pipelines: Vec<PipelineSnapshot>) -> LiveState {
    LiveState {
        at: NOW,
        aggregator: slug("rack-a"),
        listening: "tcp://127.0.0.1:5550".into(),
        hosts: hosts.into_iter().map(Arc::new).collect(),
        pipelines: pipelines.into_iter().map(Arc::new).collect(),
        links: Vec::new(),
        refused: Vec::new(),
        absent: 0,
        totals: Totals::default(),
    }
}

/// Returns a sample of a cloud's clock, with an offset of 1.204 s that grows by 12.4 ppm, and delays of 6.3 and 0.6 ms.
/// `half` is half the width of the bounds of offset and delays, seconds; `None` for a sample without an offset. The
/// bounds that chrony claims are always ±1.9 ms.
pub(crate) fn clock_sample(at: WallTime, relation_period: u64, half: Option<f64>) -> ClockSample {
    let seconds = Span::from_seconds_f64;
    let estimate = seconds(1.204 + 12.4e-6 * (at - NOW).seconds());
    let offset = half.map(|half| {
        let bounds = Interval { lo: estimate - seconds(half), hi: estimate + seconds(half) };
        let wider = Interval { lo: estimate - seconds(0.0019), hi: estimate + seconds(0.0019) };
        Offset {
            at,
            estimate,
            bounds,
            source: DelaySource::Intersection,
            sources: vec![(DelaySource::InBand, bounds), (DelaySource::Chrony, wider)],
            verdict: Verdict::Ok,
            skew_ppm: Some(12.4),
            exchanges: 612,
            age: Some(seconds(0.05)),
        }
    });
    let delay = |value: f64, bits: f64| DelaySecond {
        count: 30,
        median: half.map(|half| DelayPoint {
            value: seconds(value),
            bounds: Interval { lo: seconds(value - half), hi: seconds(value + half) },
            bits_per_second: Some(bits / value),
        }),
        verdict: match half {
            None => Verdict::Unsynchronised,
            Some(half) if half * 4.0 > value => Verdict::Limited,
            Some(_) => Verdict::Ok,
        },
    };
    ClockSample {
        peer: HostId::from_bytes([9; 16]),
        peer_name: slug("rack-a"),
        at,
        relation_period,
        max_drift_ppm: 50.0,
        upper: None,
        lower: None,
        offset,
        probes: ProbeCounts { sent: 10, answered: 10, lost: 0, refused: 0 },
        exchanges: half.map_or_else(ExchangeCounts::default, |_| ExchangeCounts {
            accepted: 6_120,
            outliers: 4,
            ..ExchangeCounts::default()
        }),
        round_trip: Some(RoundTrip { min: seconds(0.0013), median: seconds(0.00175) }),
        up: Some(delay(0.0063, 1.2e6)),
        down: Some(delay(0.0006, 3.3e3)),
        network: NetworkName::default(),
        basis: None,
    }
}

/// Returns [`clock_sample`] as a point of a history.
pub(crate) fn clock_point(at: WallTime, relation_period: u64, half: Option<f64>) -> ClockPoint {
    let sample = clock_sample(at, relation_period, half);
    ClockPoint {
        clocks: sample.clocks(),
        proven_skew_ppm: sample.basis.and_then(|basis| basis.proven_skew_ppm),
        oldest_exchange_age: sample.basis.and_then(|basis| basis.oldest_exchange_age),
        at: sample.at,
        relation_period: sample.relation_period,
        offset: sample.offset,
        probes: sample.probes,
        round_trip: sample.round_trip,
        up: sample.up,
        down: sample.down,
    }
}

/// Returns a link from `cam-1` to `rack-a` with a history of two minutes of [`clock_sample`]s with this `half`. The
/// history lacks the seconds whose ages, in seconds, are in `gaps`.
pub(crate) fn link(half: Option<f64>, gaps: &[i64]) -> LinkSnapshot {
    let second = |ago: i64| WallTime::from_unix_nanos((NOW.unix_seconds() - ago) * 1_000_000_000);
    let ages = (0..120).rev().filter(|ago| !gaps.contains(ago));
    LinkSnapshot {
        edge: host_id(),
        edge_name: slug("cam-1"),
        connected: true,
        last_seen: NOW,
        live: LinkLive {
            peer: HostId::from_bytes([9; 16]),
            peer_name: slug("rack-a"),
            networks: vec!["zmq-tcp".into()],
            pipelines: vec![slug("line")],
            same_clock: false,
            probing: Probing::On {
                address: "udp://192.0.2.5:8620".into(),
                rate_hz: 10.0,
                stamps: "kernel, receive only".into(),
            },
            edge: Some(HostClock { text: "chrony, stratum 2".into(), ..HostClock::default() }),
            cloud: None,
            latest_sample: clock_sample(second(0), 1, half),
            connections: vec![connection()],
            reflector: None,
        },
        history: ages.map(|ago| Arc::new(clock_point(second(ago), 1, half))).collect(),
    }
}

/// Returns the connection of the pipeline `line` on the link of [`link`].
fn connection() -> Connection {
    let sent = DirectionStatistics {
        bytes: 1_250_000_000,
        messages: 10_482,
        datagrams: Some(863_204),
        lost: None,
        duplicated: Some(0),
        reordered: Some(0),
        retransmitted: Some(17),
    };
    let received = DirectionStatistics {
        bytes: 1_400_000,
        messages: 10_480,
        datagrams: Some(10_655),
        reordered: Some(3),
        ..DirectionStatistics::default()
    };
    Connection {
        pipeline: slug("line"),
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
            lost_messages: 2,
            round_trip: Some(TransportRoundTrip {
                min: Some(Span::from_micros(1_080)),
                smoothed: Span::from_micros(2_310),
                variation: Span::from_micros(140),
            }),
            ..ConnectionStatistics::default()
        },
        cloud: Some(ConnectionStatistics {
            sent: DirectionStatistics {
                bytes: 1_400_000,
                messages: 10_480,
                datagrams: Some(10_655),
                duplicated: Some(0),
                reordered: Some(0),
                retransmitted: Some(4),
                ..DirectionStatistics::default()
            },
            received: DirectionStatistics {
                bytes: 1_249_900_000,
                messages: 10_481,
                datagrams: Some(863_100),
                reordered: Some(12),
                ..DirectionStatistics::default()
            },
            ..ConnectionStatistics::default()
        }),
    }
}

/// Returns the link of [`link`] without gaps, over `zmq-udp`.
pub(crate) fn link_over_udp(half: Option<f64>) -> LinkSnapshot {
    let mut link = link(half, &[]);
    let network: NetworkName = "zmq-udp".parse().expect("a name");
    link.live.networks = vec![network.to_string()];
    link.live.latest_sample.network = network;
    link
}

pub(crate) fn refused(reason: &str) -> RefusedHost {
    RefusedHost { name: slug("cam-9"), address: None, reason: reason.to_owned(), at: NOW }
}

pub(crate) fn incident(kind: &str, text: &str) -> IncidentRow {
    IncidentRow {
        id: 1,
        at: NOW,
        kind: kind.to_owned(),
        host: Some(host_id()),
        host_name: Some(slug("cam-1")),
        pipeline: None,
        run: Some(412),
        peer: None,
        text: text.to_owned(),
    }
}

/// Returns an iteration of a long run, with an empty tree.
pub(crate) fn iteration() -> IterationDetail {
    IterationDetail {
        row: IterationRow {
            number: 10_482,
            episode: 12,
            step: 3,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            started: NOW,
            total: Some(0.0302),
            factor: Some(1.87),
            causes: Vec::new(),
            stages: Vec::new(),
            unattributed: None,
            both_ways: None,
            delays: Vec::new(),
        },
        tree: Tree::new(stage::ITERATION, Anchor { host: host_id(), wall: NOW }),
        hosts: vec![Some(slug("cam-1")), Some(slug("rack-a"))],
        rank: Some(19),
        previous: Some(10_481),
        next: Some(10_483),
        slower: Some(8_120),
        faster: Some(12_007),
        run_figures: MEANS.map(|(name, mean)| (Name::from(name), figures(mean, 17_640))).to_vec(),
    }
}
