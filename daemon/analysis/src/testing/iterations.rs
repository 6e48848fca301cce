//! Iterations for tests, with trees like those that an agent records.

use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::{Anchor, HostId, Measure, Name, Rate, RunId, Transit, Tree, Unit, stage};
use peernet_stream::{Iteration, Outcome};

/// Start of each iteration, nanoseconds since the Unix epoch: 2026-11-20 12:54:53 UTC.
pub(crate) const START_NANOS: i64 = 1_795_179_293_000_000_000;

/// Returns a tree that has only a root.
pub(crate) fn tree() -> Tree {
    let anchor = Anchor { host: HostId::from_bytes([7; 16]), wall: WallTime::from_unix_nanos(START_NANOS) };
    Tree::new(stage::ITERATION, anchor)
}

/// Adds a node below the node with the path `parent`.
pub(crate) fn add(tree: &mut Tree, parent: &[&str], name: impl Into<Name>, measure: Measure) {
    let parent = tree.find(parent).expect("a node at this path").0;
    tree.add(parent, name.into(), Span::ZERO, measure);
}

pub(crate) fn timer(micros: i64) -> Measure {
    Measure::Timer(Some(Span::from_micros(micros)))
}

/// Returns a message with a delay that is known to ±10 µs.
pub(crate) fn transit(micros: i64) -> Measure {
    let (value, half) = (Span::from_micros(micros), Span::from_micros(10));
    let delay = OneWayDelay {
        raw: value + Span::from_millis(5),
        value: Some(value),
        bounds: Some(Interval { lo: value - half, hi: value + half }),
        source: DelaySource::InBand,
        verdict: Verdict::Ok,
    };
    let sent = WallTime::from_unix_nanos(START_NANOS);
    Measure::Transit(Box::new(Transit {
        sent,
        received: Some(sent + value),
        delay: Some(delay),
        raw_stamps: None,
    }))
}

/// Returns the tree that an offloaded iteration logs. The durations of `upload` and `inference` are in microseconds.
pub(crate) fn offloaded(upload: i64, inference: i64) -> Tree {
    let mut tree = tree();
    let bytes = |bytes: f64| Measure::Value(bytes, Unit::BYTES);
    let rate = |rate: f64| {
        Measure::Throughput(Rate { value: Some(rate), bounds: Some((rate / 2.0, f64::INFINITY)) })
    };
    let root: &[&str] = &[];
    add(&mut tree, root, stage::SENSING, timer(700));
    add(&mut tree, &["sensing"], stage::CAPTURE, timer(500));
    add(&mut tree, &["sensing"], stage::TRANSFORM, timer(150));
    add(&mut tree, root, stage::UPLOAD, transit(upload));
    add(&mut tree, root, stage::INFERENCE, timer(inference));
    add(&mut tree, &["inference"], "pre", timer(30));
    add(&mut tree, root, stage::DOWNLOAD, transit(400));
    add(&mut tree, root, stage::UPLOAD_BYTES, bytes(150_000.0));
    add(&mut tree, root, stage::UPLOAD_LOGGER_BYTES, bytes(120.0));
    add(&mut tree, root, stage::DOWNLOAD_BYTES, bytes(40.0));
    add(&mut tree, root, stage::DOWNLOAD_LOGGER_BYTES, bytes(130.0));
    add(&mut tree, root, stage::UPLOAD_THROUGHPUT, rate(8e8));
    add(&mut tree, root, stage::DOWNLOAD_THROUGHPUT, rate(4e6));
    // The remaining 25 µs of the total belong to no stage.
    let stages = 700 + upload + inference + 400;
    add(&mut tree, root, stage::TOTAL, timer(stages + 25));
    add(&mut tree, root, stage::STAGES_TOTAL, timer(stages));
    add(&mut tree, root, stage::UNATTRIBUTED, timer(25));
    tree
}

pub(crate) fn iteration(number: u64, outcome: Outcome, tree: Tree) -> Iteration {
    Iteration {
        run: RunId::from_bytes([1; 16]),
        number,
        episode: 0,
        step: (number - 1) as u32,
        warm_up: number <= 2,
        outcome,
        tree,
    }
}

/// Returns `count` iterations. The first two are warm-up, and the sixth is lost.
pub(crate) fn iterations(count: u64) -> Vec<Iteration> {
    let iteration_with_number = |number: u64| match number {
        6 => iteration(number, Outcome::Lost("the connection broke, \"reset\"".to_owned()), tree()),
        _ => iteration(number, Outcome::Ok, offloaded(17_000 + number as i64, 3_700)),
    };
    (1..=count).map(iteration_with_number).collect()
}
