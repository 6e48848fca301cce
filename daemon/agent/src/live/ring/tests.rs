//! Tests of the latest seconds of a pipeline.

use std::sync::Arc;

use peernet_analysis::actuator_results::{EPISODE_RETURN, EPISODE_SUCCESS};
use peernet_clock::{ClockIdentity, Interval, ManualClock, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::{HostId, Measure, Recorder, stage};

use super::*;

/// Returns a tree whose upload takes `millis` milliseconds.
fn tree(millis: i64) -> Tree {
    let clock =
        Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
    let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
    let upload = log.start_transit(stage::UPLOAD, peernet_clock::Clock::stamp(&*clock));
    log.end_transit(upload, WallTime::from_unix_nanos(0) + Span::from_millis(millis));
    if let Some(Measure::Transit(transit)) = log.tree_mut().measure_mut(upload) {
        transit.delay = Some(OneWayDelay::same_clock(Span::from_millis(millis)));
    }
    log.finish()
}

/// Records an iteration that is not warm-up and that ends in the second `at`.
fn record_after_warm_up(ring: &mut Ring, at: i64, outcome: &Outcome, tree: &Tree) {
    let is_warm_up = false;
    ring.record(at, outcome, is_warm_up, tree);
}

#[test]
fn sent_second_is_repeated_only_after_change() {
    let mut ring = Ring::default();
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &tree(4));
    record_after_warm_up(&mut ring, 11, &Outcome::Ok, &tree(6));
    record_after_warm_up(&mut ring, 11, &Outcome::Timeout(String::new()), &tree(500));

    let (seconds, sent) = ring.changed_seconds();
    assert_eq!(seconds.iter().map(|second| second.at).collect::<Vec<_>>(), [11, 10]);
    assert_eq!((seconds[0].counts.ok, seconds[0].counts.timeout), (1, 1));
    let (name, upload) = &seconds[0].values[0];
    assert_eq!((name.as_str(), upload.count(), upload.moments.mean), ("upload", 1, 0.006));
    assert_eq!(seconds[0].bounds[0].1.moments.max, 0.0, "the interval of a delay on one clock has no width");
    assert_eq!(seconds[0].verdicts, [("upload".into(), "ok".into(), 1)]);

    assert_eq!(ring.changed_seconds().0.len(), 2, "not marked as sent, so they are returned again");
    record_after_warm_up(&mut ring, 11, &Outcome::Ok, &tree(8));
    ring.mark_sent(&sent);
    let (seconds, _) = ring.changed_seconds();
    assert_eq!((seconds.len(), seconds[0].at, seconds[0].counts.ok), (1, 11, 2));
}

#[test]
fn second_without_answers_shows_that_deadline_exists() {
    let mut ring = Ring::default();
    let with_deadline = |missed: f64| {
        let mut tree = tree(4);
        let measure = Measure::Value(missed, peernet_logger::Unit::NONE);
        tree.add(peernet_logger::NodeId::ROOT, "deadline-missed".into(), Span::ZERO, measure);
        tree
    };
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &with_deadline(0.0));
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &with_deadline(1.0));
    record_after_warm_up(&mut ring, 11, &Outcome::Timeout(String::new()), &with_deadline(1.0));
    record_after_warm_up(&mut ring, 12, &Outcome::Timeout(String::new()), &tree(4));
    let deadline_summary = |second: &Second| {
        let summary = second.values.iter().find(|(name, _)| name == "deadline-missed");
        summary.map(|(_, summary)| (summary.count(), summary.moments.mean))
    };
    let (seconds, _) = ring.changed_seconds();
    assert_eq!(deadline_summary(&seconds[2]), Some((2, 0.5)));
    assert_eq!(deadline_summary(&seconds[1]).map(|(count, _)| count), Some(0));
    assert_eq!((seconds[1].values.len(), deadline_summary(&seconds[0])), (1, None));
}

#[test]
fn skipped_starts_of_unanswered_iteration_are_counted() {
    let mut ring = Ring::default();
    let mut timed_out = tree(4);
    let measure = Measure::Value(5.0, peernet_logger::Unit::NONE);
    timed_out.add(peernet_logger::NodeId::ROOT, "skipped-starts".into(), Span::ZERO, measure);
    record_after_warm_up(&mut ring, 10, &Outcome::Timeout(String::new()), &timed_out);
    let second = &ring.changed_seconds().0[0];
    assert_eq!(second.values.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["skipped-starts"]);
    assert_eq!(second.values[0].1.moments.mean, 5.0);
}

#[test]
fn result_of_episode_that_ends_in_warm_up_is_counted() {
    let mut ring = Ring::default();
    let is_warm_up = true;
    ring.record(9, &Outcome::Ok, is_warm_up, &tree(4));
    assert_eq!(ring.changed_seconds().0, [], "warm-up has no statistics");
    // Each episode has one step. Only episode 2 succeeds, and only its step is not warm-up.
    let iteration = |number: u64| {
        let (is_success, is_warm_up) = (number == 2, number != 2);
        let mut tree = tree(4);
        for (name, value) in [(EPISODE_SUCCESS, f64::from(u8::from(is_success))), (EPISODE_RETURN, -3.0)] {
            let measure = Measure::Value(value, peernet_logger::Unit::NONE);
            tree.add(peernet_logger::NodeId::ROOT, name.into(), Span::ZERO, measure);
        }
        peernet_stream::Iteration {
            run: peernet_logger::RunId::random(),
            number,
            episode: number as u32,
            step: 0,
            warm_up: is_warm_up,
            outcome: Outcome::Ok,
            tree,
        }
    };
    let iterations = [1, 2, 3].map(iteration);
    for iteration in &iterations {
        ring.record(10, &iteration.outcome, iteration.warm_up, &iteration.tree);
    }
    let second = &ring.changed_seconds().0[0];
    let mean = |name: &str| {
        let (_, summary) = second.values.iter().find(|(other, _)| other == name).expect("is recorded");
        (summary.count(), summary.moments.mean)
    };
    let rows = iterations.iter().map(peernet_analysis::rows::Row::from_iteration);
    let rows: peernet_analysis::rows::Rows = rows.collect();
    let results = peernet_analysis::actuator_results::ActuatorResults::from_rows(&rows);
    let success = results.success.expect("is reported");
    assert_eq!((mean("episode-success").0, success.episodes), (3, 3));
    assert!((mean("episode-success").1 - success.rate).abs() < 1e-12, "{success:?}");
    let return_of_rows = results.episode_return.map(|mean_return| (mean_return.episodes, mean_return.mean));
    assert_eq!((Some(mean("episode-return")), mean("upload").0), (return_of_rows, 1));
    assert_eq!(second.counts.total(), 1, "only iteration 2 is not warm-up");
}

#[test]
fn stage_of_several_nodes_equals_column_of_results() {
    let mut tree = tree(4);
    let root = peernet_logger::NodeId::ROOT;
    let timer = |millis| Measure::Timer(Some(Span::from_millis(millis)));
    let inference = tree.add(root, stage::INFERENCE, Span::ZERO, timer(40));
    let inner = tree.add(inference, "inner-model".into(), Span::ZERO, timer(10));
    for name in [stage::PREPROCESSING, stage::INFERENCE] {
        tree.add(inner, name, Span::ZERO, timer(5));
    }
    tree.add(root, stage::SEND_QUEUE, Span::ZERO, timer(1));
    tree.add(root, stage::SEND_QUEUE, Span::ZERO, timer(2));
    let mut ring = Ring::default();
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &tree);
    let second = &ring.changed_seconds().0[0];
    let iteration = peernet_stream::Iteration {
        run: peernet_logger::RunId::random(),
        number: 1,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        tree,
    };
    let row = peernet_analysis::rows::Row::from_iteration(&iteration);
    for name in ["upload", "preprocessing", "inference", "send-queue"] {
        let summary = second.values.iter().find(|(other, _)| other == name).map(|(_, summary)| summary);
        let live = summary.map(|summary| (summary.count(), summary.moments.mean));
        assert_eq!(live, row.value(name).map(|seconds| (1, seconds)), "{name}");
    }
}

#[test]
fn delays_without_value_are_counted_and_not_averaged() {
    let mut ring = Ring::default();
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &tree(4));
    let mut inconsistent = tree(0);
    let upload = inconsistent.find(&["upload"]).expect("recorded").0;
    let delay = OneWayDelay {
        value: None,
        bounds: Some(Interval { lo: Span::ZERO, hi: Span::from_seconds(9) }),
        verdict: Verdict::Inconsistent,
        ..OneWayDelay::same_clock(Span::from_millis(3))
    };
    if let Some(Measure::Transit(transit)) = inconsistent.measure_mut(upload) {
        transit.delay = Some(delay);
    }
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &inconsistent);
    // The delay is negative, because the clock was set back. Its verdict is `stepped`.
    record_after_warm_up(&mut ring, 10, &Outcome::Ok, &tree(-1));

    let second = &ring.changed_seconds().0[0];
    assert_eq!(second.counts.ok, 3);
    assert_eq!((second.values[0].1.count(), second.values[0].1.moments.mean), (1, 0.004));
    let bounds =
        second.bounds.iter().map(|(name, summary)| (name.as_str(), summary.count(), summary.moments.max));
    let expected = [("upload", 1, 0.0), ("upload-lo", 1, 0.004), ("upload-hi", 1, 0.004)];
    assert_eq!(bounds.collect::<Vec<_>>(), expected);
    let verdicts = ["ok", "stepped", "inconsistent"].map(|verdict| ("upload".into(), verdict.into(), 1));
    assert_eq!(second.verdicts, verdicts);
}

#[test]
fn updates_and_memory_are_bounded_without_reader() {
    let mut ring = Ring::default();
    for at in 0..1000 {
        record_after_warm_up(&mut ring, at, &Outcome::Ok, &tree(1));
    }
    assert_eq!(ring.seconds.len(), MAX_SECONDS);
    let mut sent_times = Vec::new();
    loop {
        let (seconds, sent) = ring.changed_seconds();
        if seconds.is_empty() {
            break;
        }
        assert!(seconds.len() <= MAX_SENT_SECONDS);
        sent_times.extend(seconds.iter().map(|second| second.at));
        ring.mark_sent(&sent);
    }
    assert!(
        sent_times.iter().copied().eq((1000 - MAX_SECONDS as i64..1000).rev()),
        "newest first: {sent_times:?}"
    );
}

#[test]
fn repeated_seconds_of_wall_clock_are_not_summed() {
    let mut ring = Ring::default();
    for at in 4990..=5000 {
        record_after_warm_up(&mut ring, at, &Outcome::Ok, &tree(1));
    }
    record_after_warm_up(&mut ring, 4999, &Outcome::Ok, &tree(1));
    assert_eq!(
        ring.seconds.len(),
        11,
        "iterations that end at nearly the same time may be recorded out of order"
    );
    let counts_by_second = |ring: &Ring| {
        ring.seconds.iter().map(|second| (second.at, second.to_message().counts.ok)).collect::<Vec<_>>()
    };
    // The wall clock is set back. The seconds from 4995 on are removed and begin again.
    record_after_warm_up(&mut ring, 4995, &Outcome::Ok, &tree(1));
    record_after_warm_up(&mut ring, 4996, &Outcome::Ok, &tree(1));
    assert_eq!(counts_by_second(&ring), (4990..=4996).map(|at| (at, 1)).collect::<Vec<_>>());
    record_after_warm_up(&mut ring, 1400, &Outcome::Ok, &tree(1));
    assert_eq!(counts_by_second(&ring), [(1400, 1)]);
}
