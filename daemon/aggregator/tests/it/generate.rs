//! Hosts, runs and iterations as agents send them, for tests and benchmarks.

use peernet_clock::{ClockIdentity, Interval, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::{
    Anchor, HostId, HostIndex, Measure, Name, Node, NodeId, Rate, RunId, Transit, Tree, Unit, stage,
};
use peernet_statistics::SplitMix64;
use peernet_stream::{
    Event, Hardware, HostDescription, Iteration, Outcome, Placement, PlacementKind, RunDescription,
};

/// Reproducible pseudo-random numbers.
#[derive(Clone, Debug)]
pub struct Numbers(SplitMix64);

impl Numbers {
    /// Creates the generator; the seed determines the numbers.
    pub const fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    /// Returns the next number, uniform over 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns the next number, uniform from `low` to `high` without `high`.
    pub fn between(&mut self, low: i64, high: i64) -> i64 {
        low + (self.bits() % (high - low) as u64) as i64
    }
}

/// Returns the time `seconds` after the start of the year 2025 (UTC).
pub fn at(seconds: f64) -> WallTime {
    WallTime::from_unix_nanos(1_735_689_600_000_000_000) + Span::from_seconds_f64(seconds)
}

/// Returns a host's description.
pub fn host(id: HostId, name: &str) -> HostDescription {
    HostDescription {
        id,
        name: name.parse().expect("a name"),
        clock: ClockIdentity::new("boot", "test"),
        version: "0.1.0".into(),
        hardware: Hardware { cpu: "test".into(), cores: 2, ..Hardware::default() },
        serves: None,
        models: vec![],
    }
}

/// Returns a placement on a cloud.
pub fn remote() -> Placement {
    Placement {
        kind: PlacementKind::Remote,
        peer: Some("cloud".parse().expect("a name")),
        network: Some("zmq-tcp".into()),
        address: Some("tcp://127.0.0.1:5551".into()),
        model: "quality".parse().expect("a name"),
        device: Some("cpu".into()),
    }
}

/// Returns the event that starts a run.
pub fn run_started(run: RunId, pipeline: &str, started: WallTime) -> Event {
    Event::RunStarted(RunDescription {
        run,
        pipeline: pipeline.parse().expect("a name"),
        started,
        placement: remote(),
        facts: vec![("Sensor".into(), "30 images".into()), ("Load".into(), "5 Hz".into())],
        configuration: "name = \"line\"\n".into(),
        version: "0.1.0".into(),
        experiment: None,
        conditions: Vec::new(),
    })
}

/// Returns an iteration over two hosts with nodes of every kind: 21 nodes. Five iterations start per second.
pub fn iteration(run: RunId, number: u64, hosts: (HostId, HostId), numbers: &mut Numbers) -> Iteration {
    iteration_at(run, number, hosts, at(number as f64 * 0.2), numbers)
}

/// Same as [`iteration`] with the given time of start.
pub fn iteration_at(
    run: RunId,
    number: u64,
    (edge, cloud): (HostId, HostId),
    started: WallTime,
    numbers: &mut Numbers,
) -> Iteration {
    let mut nodes = Vec::with_capacity(21);
    let mut now = Span::ZERO;
    let mut add = |parent: u32, name: Name, host: u8, start: Span, measure: Measure| {
        nodes.push(Node { parent: Some(NodeId(parent)), name, host: HostIndex(host), start, measure });
        nodes.len() as u32
    };
    let mut timer = |now: &mut Span, low: i64, high: i64| {
        let span = Span::from_nanos(numbers.between(low, high));
        *now += span;
        Measure::Timer(Some(span))
    };
    add(0, stage::SENSING, 0, now, timer(&mut now, 900_000, 1_100_000));
    add(1, stage::CAPTURE, 0, Span::ZERO, Measure::Timer(Some(Span::from_micros(600))));
    add(1, stage::TRANSFORM, 0, Span::from_micros(600), Measure::Timer(Some(Span::from_micros(300))));
    add(0, stage::ENCODE, 0, now, timer(&mut now, 20_000, 40_000));
    add(0, stage::SEND_QUEUE, 0, now, timer(&mut now, 1_000, 5_000));
    let up = numbers.between(2_000_000, 8_000_000);
    add(0, stage::UPLOAD, 0, now, transit(started + now, up));
    now += Span::from_nanos(up);
    let mut cloud_time = Span::ZERO;
    // The closure is created a second time, because it borrows `numbers`, and `up` is drawn in between.
    let mut timer = |now: &mut Span, low: i64, high: i64| {
        let span = Span::from_nanos(numbers.between(low, high));
        *now += span;
        Measure::Timer(Some(span))
    };
    let start = cloud_time;
    add(0, stage::QUEUE, 1, start, timer(&mut cloud_time, 5_000, 50_000));
    let start = cloud_time;
    add(0, stage::PREPROCESSING, 1, start, timer(&mut cloud_time, 1_000_000, 1_500_000));
    let start = cloud_time;
    add(0, stage::INFERENCE, 1, start, timer(&mut cloud_time, 9_000_000, 12_000_000));
    let start = cloud_time;
    add(0, stage::POSTPROCESSING, 1, start, timer(&mut cloud_time, 100_000, 200_000));
    now += cloud_time;
    let down = numbers.between(300_000, 900_000);
    add(0, stage::DOWNLOAD, 1, cloud_time, transit(started + now, down));
    now += Span::from_nanos(down);
    add(0, stage::ACTUATION, 0, now, Measure::Timer(Some(Span::from_micros(12))));
    now += Span::from_micros(12);
    add(0, stage::UPLOAD_BYTES, 0, now, Measure::Value(150_000.0, Unit::BYTES));
    let rate = 150_000.0 * 8.0 / (up as f64 * 1e-9);
    let rate = Rate { value: Some(rate), bounds: Some((rate * 0.9, f64::INFINITY)) };
    add(0, stage::UPLOAD_THROUGHPUT, 0, now, Measure::Throughput(rate));
    add(0, "tokens-per-second".into(), 1, cloud_time, Measure::TokenRate(None));
    add(0, "gpu-power".into(), 1, cloud_time, Measure::Custom("power".into(), Unit::WATTS, Some(11.5)));
    add(0, "gripper".into(), 0, now, Measure::Custom("value".into(), Unit::NONE, None));
    add(0, stage::TOTAL, 0, Span::ZERO, Measure::Timer(Some(now)));
    add(0, stage::STAGES_TOTAL, 0, Span::ZERO, Measure::Timer(Some(now)));
    add(0, stage::UNATTRIBUTED, 0, Span::ZERO, Measure::Timer(Some(Span::ZERO)));
    let root = Node {
        parent: None,
        name: stage::ITERATION,
        host: HostIndex::EDGE,
        start: Span::ZERO,
        measure: Measure::Container,
    };
    nodes.insert(0, root);
    let anchors = vec![
        Anchor { host: edge, wall: started },
        Anchor { host: cloud, wall: started + Span::from_millis(9) },
    ];
    let tree = Tree::from_parts(anchors, nodes).expect("a tree");
    Iteration { run, number, episode: 0, step: number as u32, warm_up: false, outcome: Outcome::Ok, tree }
}

/// Returns a transit with a one-way delay of `nanos` and bounds of ± 40 µs.
fn transit(sent: WallTime, nanos: i64) -> Measure {
    let span = Span::from_nanos(nanos);
    let half_width = Span::from_micros(40);
    let delay = OneWayDelay {
        bounds: Some(Interval { lo: span - half_width, hi: span + half_width }),
        verdict: Verdict::Limited,
        ..OneWayDelay::same_clock(span)
    };
    Measure::Transit(Box::new(Transit {
        sent,
        received: Some(sent + span),
        delay: Some(delay),
        raw_stamps: None,
    }))
}

/// Encodes events one after the other: the body of a batch.
pub fn body(events: &[Event]) -> Vec<u8> {
    events.iter().flat_map(|event| rmp_serde::to_vec(event).expect("plain data")).collect()
}
