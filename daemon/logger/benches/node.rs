//! Benchmark of the logger: one timed node compared with the two clock reads that it needs, the wire form of a typical
//! tree, and the addition of a value to a summary. Prints a table of medians over interleaved repeats.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::hint::black_box;
use std::sync::Arc;

use peernet_clock::{ClockIdentity, OneWayDelay, SharedClock, Span, SystemClock};
use peernet_logger::{HostId, Measure, NodeId, Rate, Recorder, Tree, Unit, stage, wire};
use peernet_statistics::Summary;

/// Repeats of every measurement. The measurements take turns, so that a disturbance affects all of them.
const REPEATS: usize = 301;
/// Trees recorded in one repeat.
const TREES: usize = 64;
/// Timed nodes of each tree. A new tree has capacity for more nodes, so that recording does not allocate.
const NODES: usize = 20;
/// Calls of all other operations in one repeat.
const CALLS: usize = 500;

fn main() {
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "system")));
    let tree = typical_tree(&clock);
    let mut bytes = Vec::new();
    wire::encode(&tree, &mut bytes);
    let packed = rmp_serde::to_vec(&tree).expect("a tree can be serialised");
    let mut summary = Summary::default();
    let durations: Vec<f64> = (0..CALLS).map(|n| 0.002 * (1.0 + (n * 7919 % 997) as f64 / 300.0)).collect();

    let names = [
        "two bare clock reads",
        "one timed node",
        "one nested timed node",
        "create and release a tree of all stages",
        "wire: encode 12 nodes",
        "wire: decode 12 nodes",
        "serde: decode 12 nodes",
        "Summary::record",
    ];
    let mut samples = vec![Vec::with_capacity(REPEATS); names.len()];
    let mut out = Vec::with_capacity(1024);
    for _ in 0..REPEATS {
        samples[0].push(time(&clock, TREES * NODES, || two_reads(&clock)));
        samples[1].push(nanos_per_node(&clock, NODES, |log| drop(log.time(stage::INFERENCE))));
        samples[2].push(nanos_per_node(&clock, NODES / 2, record_nested_nodes));
        samples[3].push(time(&clock, TREES, || create_and_release_tree(&clock)));
        samples[4].push(time(&clock, CALLS, || {
            out.clear();
            wire::encode(black_box(&tree), &mut out);
        }));
        samples[5].push(time(&clock, CALLS, || drop(black_box(wire::decode(black_box(&bytes))))));
        samples[6]
            .push(time(&clock, CALLS, || drop(black_box(rmp_serde::from_slice::<Tree>(black_box(&packed))))));
        let mut next = durations.iter().cycle();
        samples[7]
            .push(time(&clock, CALLS, || next.by_ref().take(1).for_each(|value| summary.record(*value))));
    }
    let medians: Vec<f64> = samples.into_iter().map(median).collect();
    for (name, nanos) in names.iter().zip(&medians) {
        println!("{name:<44}{nanos:>10.1} ns");
    }
    println!(
        "{:<44}{:>10.2} x two clock reads (aim: at most 2.5)",
        "one timed node",
        medians[1] / medians[0]
    );
    println!(
        "{:<44}{:>10.2} x two clock reads (aim: at most 2.5)",
        "one nested timed node",
        medians[2] / medians[0]
    );
    println!("{:<44}{:>10} bytes of {} nodes", "wire form", bytes.len(), tree.nodes().len());
    println!("{:<44}{:>10} bytes", "packed sketch of the summary", summary.sketch.to_bytes().len());
}

/// Returns the nanoseconds per call.
fn time(clock: &SharedClock, calls: usize, mut call: impl FnMut()) -> f64 {
    let started_at = clock.mono();
    (0..calls).for_each(|_| call());
    (clock.mono() - started_at).nanos() as f64 / calls as f64
}

/// Returns the nanoseconds per timed node over [`TREES`] new recorders. For each recorder, `calls` calls of `record`
/// create [`NODES`] timed nodes.
fn nanos_per_node(clock: &SharedClock, calls: usize, record: impl Fn(&mut Recorder)) -> f64 {
    let host = HostId::random();
    let mut logs: Vec<Recorder> = (0..TREES).map(|_| Recorder::new(clock.clone(), host)).collect();
    let started_at = clock.mono();
    for log in &mut logs {
        (0..calls).for_each(|_| record(log));
    }
    (clock.mono() - started_at).nanos() as f64 / (TREES * NODES) as f64
}

fn two_reads(clock: &SharedClock) {
    let started_at = black_box(clock.mono());
    black_box(clock.mono() - started_at);
}

fn record_nested_nodes(log: &mut Recorder) {
    let mut outer = log.time(stage::SENSING);
    drop(outer.time(stage::CAPTURE));
}

fn create_and_release_tree(clock: &SharedClock) {
    let mut log = Recorder::new(clock.clone(), HostId::from_bytes([7; 16]));
    for name in stage::ORDER.into_iter().chain([stage::CAPTURE, stage::TOTAL]) {
        drop(log.time(name));
    }
    drop(black_box(log.finish()));
}

/// Returns the tree of an offloaded iteration as it is stored.
fn typical_tree(clock: &SharedClock) -> Tree {
    let mut log = Recorder::new(clock.clone(), HostId::random());
    {
        let mut sensing = log.time(stage::SENSING);
        drop(sensing.time(stage::CAPTURE));
    }
    let sent = clock.stamp();
    let upload = log.start_transit(stage::UPLOAD, sent);
    let (cloud_clock, arrival) = (clock.clone(), clock.stamp());
    let tree = log.tree().clone();
    let mut remote =
        Recorder::resume(cloud_clock, HostId::random(), tree, upload, arrival).expect("the transit is open");
    for name in [stage::QUEUE, stage::PREPROCESSING, stage::INFERENCE, stage::POSTPROCESSING] {
        drop(remote.time(name));
    }
    let download = remote.start_transit(stage::DOWNLOAD, clock.stamp());
    log.tree_mut()
        .apply_delta(remote.into_tree_delta().expect("the tree was resumed"))
        .expect("the delta fits");
    log.end_transit(download, clock.wall());
    for transit in [upload, download] {
        if let Some(Measure::Transit(transit)) = log.tree_mut().measure_mut(transit) {
            transit.delay = Some(OneWayDelay::same_clock(Span::from_micros(136)));
        }
    }
    log.record_value(stage::UPLOAD_BYTES, 150_000.0, Unit::BYTES);
    log.record_value(stage::UPLOAD_LOGGER_BYTES, 231.0, Unit::BYTES);
    let rate = Rate { value: Some(8.8e9), bounds: Some((8.7e9, 8.9e9)) };
    log.tree_mut().add(NodeId::ROOT, stage::UPLOAD_THROUGHPUT, Span::ZERO, Measure::Throughput(rate));
    log.finish()
}

fn median(mut samples: Vec<f64>) -> f64 {
    samples.sort_by(f64::total_cmp);
    samples[samples.len() / 2]
}
