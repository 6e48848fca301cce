//! Intervals of medians that follow from clock bounds. The store computes an interval from statistics, and results do so
//! from the single values in files. Both intervals are equal.

use peernet_analysis::delays::{ClockInterval, ClockedSummaries, IntervalMethod};
use peernet_analysis::rows::{Row, Rows};
use peernet_analysis::summary::median_bounds_of;
use peernet_clock::{Interval, OneWayDelay, Span, Verdict};
use peernet_logger::{Measure, Name, NodeId, Rate, RunId, Unit, stage};
use peernet_statistics::Sketch;
use peernet_stream::{Event, Iteration};

use super::{NOW, TestStore, generate};
use crate::rebuild::rebuild;
use crate::types::MergeableStatistics;

/// Number of iterations.
const COUNT: u64 = 300;
/// Quantities with an interval, each with the delay whose bounds determine the interval.
const QUANTITIES: [(Name, Name); 4] = [
    (stage::UPLOAD, stage::UPLOAD),
    (stage::DOWNLOAD, stage::DOWNLOAD),
    (stage::UPLOAD_THROUGHPUT, stage::UPLOAD),
    (stage::DOWNLOAD_THROUGHPUT, stage::DOWNLOAD),
];

impl TestStore {
    /// Makes an iteration whose delays lie near the lower ends of their bounds. For two fifths of the uploads the lower
    /// end is zero. Downloads are negative, as in an observed system. Message sizes and widths of bounds vary.
    fn iteration_with_uneven_bounds(&self, run: RunId, number: u64) -> Iteration {
        let mut iteration =
            generate::iteration(run, number, self.hosts(), &mut generate::Numbers::new(number));
        let scattered = |factor: u64| (number * factor % 1_001) as f64 / 1_001.0;
        let (value, width) = (0.4e-3 + 2e-3 * scattered(379), 0.2e-3 + 2e-3 * scattered(613));
        let lo = if number % 5 < 2 { 0.0 } else { (value - 0.1 * width).max(0.0) };
        let down = -0.3e-3 + 0.1e-3 * scattered(379);
        let bits = 8.0 * (10e3 + 90e3 * scattered(17));
        let bounds = [(value, lo, value + 0.9 * width), (down, down - 0.5e-3, down + width)];
        for ((delay, throughput), (value, lo, hi)) in
            [(stage::UPLOAD, stage::UPLOAD_THROUGHPUT), (stage::DOWNLOAD, stage::DOWNLOAD_THROUGHPUT)]
                .into_iter()
                .zip(bounds)
        {
            let tree = &mut iteration.tree;
            let (id, _) = tree.find(&[delay.as_str()]).expect("a delay");
            let Some(Measure::Transit(transit)) = tree.measure_mut(id) else { panic!("{delay}: no transit") };
            let [value_span, lo_span, hi_span] = [value, lo, hi].map(Span::from_seconds_f64);
            transit.delay = Some(OneWayDelay {
                value: Some(value_span),
                bounds: Some(Interval { lo: lo_span, hi: hi_span }),
                verdict: Verdict::Limited,
                ..OneWayDelay::same_clock(value_span)
            });
            let rate = |seconds: f64| if seconds > 0.0 { bits / seconds } else { f64::INFINITY };
            let value = Some(rate(value)).filter(|rate| rate.is_finite());
            let measure = Measure::Throughput(Rate { value, bounds: Some((rate(hi), rate(lo))) });
            match tree.find(&[throughput.as_str()]).map(|(id, _)| id) {
                Some(id) => *tree.measure_mut(id).expect("the node") = measure,
                None => {
                    tree.add(NodeId::ROOT, throughput, Span::ZERO, measure);
                }
            }
        }
        let sizes = [
            stage::UPLOAD_BYTES,
            stage::UPLOAD_LOGGER_BYTES,
            stage::DOWNLOAD_BYTES,
            stage::DOWNLOAD_LOGGER_BYTES,
        ];
        // A message has two parts, the payload and the logger data. Each part has half of the
        // message's bytes.
        for name in sizes {
            if iteration.tree.find(&[name.as_str()]).is_none() {
                iteration.tree.add(NodeId::ROOT, name, Span::ZERO, Measure::Value(bits / 16.0, Unit::BYTES));
            }
        }
        iteration
    }
}

fn interval(statistics: &MergeableStatistics, name: &Name, delay: &Name) -> Option<ClockInterval> {
    let clocked = ClockedSummaries {
        values: statistics.summary(name)?,
        ends: statistics.ends(name),
        delays: statistics.summary(delay)?,
        half_widths: statistics.half_widths(delay),
    };
    if name == delay { clocked.interval_of_median_delay() } else { clocked.interval_of_median_throughput() }
}

/// Asserts that the interval of each median equals the interval from the rows, within the error of a sketch.
fn assert_equal_to_rows(statistics: &MergeableStatistics, rows: &Rows) {
    for (name, delay) in &QUANTITIES {
        let page = interval(statistics, name, delay);
        let Some(file) = median_bounds_of(rows, name) else {
            // The throughput of downloads has no values, because the downloads are negative.
            assert_eq!((page, name == delay), (None, false), "{name}");
            continue;
        };
        let page = page.unwrap_or_else(|| panic!("{name}: no interval, {file:?} in files"));
        let near = |a: f64, b: f64| a == b || (a - b).abs() <= Sketch::RELATIVE_ERROR * b.abs();
        assert!(near(page.lo, file.0) && near(page.hi, file.1), "{name}: {file:?} {page:?}");
        assert_eq!(page.method, IntervalMethod::Ends, "{name}");
    }
}

#[tokio::test]
async fn median_of_stored_run_has_interval_of_files() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let iterations: Vec<Iteration> =
        (1..=COUNT).map(|number| test_store.iteration_with_uneven_bounds(run, number)).collect();
    let rows: Rows = iterations.iter().map(Row::from_iteration).collect();
    // Two commits: the second commit merges its interval ends with those of the first.
    let (first, second) = iterations.split_at(100);
    let started = std::iter::once(generate::run_started(run, "line", NOW));
    for events in [
        started.chain(first.iter().cloned().map(Event::Iteration)).collect::<Vec<Event>>(),
        second.iter().cloned().map(Event::Iteration).collect(),
    ] {
        let work = test_store.batch(events);
        test_store.commit(&[work]).await;
    }
    let stored = test_store.store.statistics_of(1).await.expect("answers");
    assert_equal_to_rows(&stored.mergeable, &rows);
    assert!(median_bounds_of(&rows, "upload-throughput").is_some(), "an upper end may be infinite");
    let upload_accuracy = stored.bounds.iter().find(|bound| bound.stage == stage::UPLOAD).expect("a delay");
    let delay = stored
        .stages
        .iter()
        .find(|statistics| statistics.stage == stage::UPLOAD)
        .expect("a delay")
        .statistics;
    assert_eq!(
        upload_accuracy.interval_of_median(&delay),
        interval(&stored.mergeable, &stage::UPLOAD, &stage::UPLOAD)
    );
    // Interval ends, the quantities 2 and 3, are stored for the whole run only, not for buckets over time.
    let ends_of_buckets =
        test_store.count("SELECT count(*) FROM rollup WHERE quantity > 1 AND resolution_s > 0").await;
    let ends_of_run =
        test_store.count("SELECT count(*) FROM rollup WHERE quantity > 1 AND resolution_s = 0").await;
    assert!(ends_of_buckets == 0 && ends_of_run >= 6, "{ends_of_buckets} {ends_of_run}");

    // Earlier versions stored no interval ends: intervals then follow from half widths, until `peernetd
    // rebuild-rollups` computes the ends.
    let mut connection = test_store.second_connection().await;
    sqlx::query("DELETE FROM rollup WHERE quantity > 1").execute(&mut connection).await.expect("deletes");
    let earlier = test_store.store.statistics_of(1).await.expect("answers");
    let method = interval(&earlier.mergeable, &stage::UPLOAD, &stage::UPLOAD).expect("half widths").method;
    assert_eq!(method, IntervalMethod::HalfWidths);
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    let rebuilt = test_store.store.statistics_of(1).await.expect("answers");
    assert_equal_to_rows(&rebuilt.mergeable, &rows);
    let sketches = |statistics: &MergeableStatistics| {
        statistics.ends("upload").map(|ends| ends.each_ref().map(|end| end.sketch.clone()))
    };
    assert_eq!(sketches(&rebuilt.mergeable), sketches(&stored.mergeable));
}
