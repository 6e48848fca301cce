//! One iteration's tree, as the edge sends it.

use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::{
    Anchor, HostId, HostIndex, Measure, Name, Node, NodeId, Rate, Transit, Tree, Unit, stage,
};

use super::{Clocks, TestPipeline, clocks};

struct Nodes(Vec<Node>);

impl Nodes {
    fn add(&mut self, parent: u32, name: Name, host: u8, start: Span, measure: Measure) -> u32 {
        self.0.push(Node { parent: Some(NodeId(parent)), name, host: HostIndex(host), start, measure });
        self.0.len() as u32 - 1
    }
}

/// Returns the delay that the edge reports for a message with the true delay `delay`. `raw` is the difference of its
/// wall-clock stamps.
fn judged_delay(pipeline: &TestPipeline, name: &Name, delay: Span, raw: Span) -> OneWayDelay {
    match pipeline.clocks {
        Clocks::Shared => OneWayDelay::same_clock(delay),
        Clocks::Unrelated => OneWayDelay::unsynchronised(raw),
        Clocks::Within(bound) => {
            let bound = Span::from_seconds_f64(bound);
            OneWayDelay {
                raw,
                value: Some(delay),
                bounds: Some(Interval { lo: (delay - bound).max(Span::ZERO), hi: delay + bound }),
                source: DelaySource::InBand,
                verdict: Verdict::from_name(pipeline.verdict(name)).expect("a verdict"),
            }
        }
    }
}

/// Returns a pseudo-random length of the answer, bytes. It depends only on the pipeline and on `at`.
fn answer_bytes(pipeline: &TestPipeline, at: WallTime) -> f64 {
    let (shortest, longest) = pipeline.answer_bytes;
    let random = at.unix_nanos().unsigned_abs().wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    (shortest + (longest - shortest) * random as f64 / f64::from(1 << 24)).round()
}

/// Returns the tree of an iteration that started at `at`. The rack's wall clock is 1.2 s ahead of the edge's wall
/// clock, unless both hosts read one clock. If `answered` is false, the upload of a remote pipeline is lost, and no
/// later stage has a node.
pub(super) fn build_tree(
    pipeline: &TestPipeline,
    stages: &[(Name, f64)],
    (edge, rack): (HostId, HostId),
    at: WallTime,
    answered: bool,
) -> Tree {
    let rack_ahead = if pipeline.clocks == Clocks::Shared { Span::ZERO } else { clocks::AHEAD };
    let stage_length = |name: Name| {
        stages.iter().find(|(stage, _)| *stage == name).map(|(_, seconds)| Span::from_seconds_f64(*seconds))
    };
    let mut anchors = vec![Anchor { host: edge, wall: at }];
    let root = Node {
        parent: None,
        name: stage::ITERATION,
        host: HostIndex::EDGE,
        start: Span::ZERO,
        measure: Measure::Container,
    };
    let mut nodes = Nodes(vec![root]);
    // `edge_time` is the time on the edge since the start of the iteration, `rack_time` the time on the rack since the
    // arrival of the request.
    let (mut edge_time, mut rack_time, mut host) = (Span::ZERO, Span::ZERO, 0);
    for (name, seconds) in stages {
        let length = Span::from_seconds_f64(*seconds);
        if *name == stage::UPLOAD {
            let received = at + edge_time + length + rack_ahead;
            let delay = judged_delay(pipeline, name, length, length + rack_ahead);
            let transit = Transit {
                sent: at + edge_time,
                received: answered.then_some(received),
                delay: answered.then_some(delay),
                raw_stamps: None,
            };
            nodes.add(0, name.clone(), 0, edge_time, Measure::Transit(Box::new(transit)));
            edge_time += length;
            if !answered {
                break;
            }
            anchors.push(Anchor { host: rack, wall: received });
            host = 1;
        } else if *name == stage::DOWNLOAD {
            edge_time += rack_time;
            let delay = judged_delay(pipeline, name, length, Span::ZERO - rack_ahead + length);
            let transit = Transit {
                sent: at + edge_time + rack_ahead,
                received: Some(at + edge_time + length),
                delay: Some(delay),
                raw_stamps: None,
            };
            nodes.add(0, name.clone(), 1, rack_time, Measure::Transit(Box::new(transit)));
            edge_time += length;
            host = 0;
        } else {
            let start = if host == 0 { edge_time } else { rack_time };
            let node = nodes.add(0, name.clone(), host, start, Measure::Timer(Some(length)));
            if *name == stage::SENSING {
                let capture = Span::from_nanos(length.nanos() * 2 / 5);
                nodes.add(node, stage::CAPTURE, 0, Span::ZERO, Measure::Timer(Some(capture)));
                nodes.add(node, stage::TRANSFORM, 0, capture, Measure::Timer(Some(length - capture)));
            }
            if host == 0 { edge_time += length } else { rack_time += length }
        }
    }
    if answered && pipeline.is_remote {
        let mut add_sizes = |names: [Name; 3], bytes: f64, logger_bytes: f64, delay: Option<Span>| {
            let transfer_time = (pipeline.clocks != Clocks::Unrelated).then_some(delay).flatten();
            let value = transfer_time.map(|delay| (bytes + logger_bytes) * 8.0 / delay.seconds());
            let [size, logger_size, throughput] = names;
            nodes.add(0, size, 0, edge_time, Measure::Value(bytes, Unit::BYTES));
            nodes.add(0, logger_size, 0, edge_time, Measure::Value(logger_bytes, Unit::BYTES));
            let bounds = value.map(|value| (value * 0.6, value * 1.8));
            nodes.add(0, throughput, 0, edge_time, Measure::Throughput(Rate { value, bounds }));
        };
        add_sizes(
            [stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES, stage::UPLOAD_THROUGHPUT],
            pipeline.bytes,
            388.0,
            stage_length(stage::UPLOAD),
        );
        add_sizes(
            [stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES, stage::DOWNLOAD_THROUGHPUT],
            answer_bytes(pipeline, at),
            902.0,
            stage_length(stage::DOWNLOAD),
        );
    }
    let unattributed = Span::from_micros(110);
    nodes.add(0, "gpu-power".into(), 0, edge_time, Measure::Custom("power".into(), Unit::WATTS, Some(11.5)));
    nodes.add(0, stage::TOTAL, 0, Span::ZERO, Measure::Timer(Some(edge_time + unattributed)));
    if answered {
        nodes.add(0, stage::STAGES_TOTAL, 0, Span::ZERO, Measure::Timer(Some(edge_time)));
        nodes.add(0, stage::UNATTRIBUTED, 0, Span::ZERO, Measure::Timer(Some(unattributed)));
    }
    Tree::from_parts(anchors, nodes.0).expect("a tree")
}
