//! Answers of the store to queries.

use peernet_analysis::rows;
use peernet_analysis::slowness::Cause;
use peernet_clock::{DelaySource, OneWayDelay, Span, Verdict};
use peernet_logger::{HostId, Measure, Name, NodeId, RunId, stage};
use peernet_statistics::Summary;
use peernet_stream::{EndReason, Event, Incident, IncidentKind, Iteration, Outcome, RunEnded};

use super::{STAMP, TestStore, generate, hello};
use crate::quantity_statistics::QuantityStatistics;
use crate::types::{IncidentFilter, IterationFilter, RunFilter, RunStatistics};

/// Returns the values of the root's child with this name in the iterations of
/// [`TestStore::store_run`].
fn values(test_store: &TestStore, run: RunId, iterations: u64, name: &str) -> Vec<f64> {
    let mut numbers = generate::Numbers::new(7);
    (1..=iterations)
        .map(|n| generate::iteration(run, n, test_store.hosts(), &mut numbers))
        .filter_map(|iteration| iteration.tree.find(&[name]).and_then(|(_, node)| node.measure.value()))
        .collect()
}

fn is_close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs()).max(1e-12)
}

#[tokio::test]
async fn statistics_of_run_are_those_of_its_iterations() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(400).await;
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    for statistics in &stages {
        let name = &statistics.stage;
        let exact = values(&test_store, run, 400, name);
        // `values` finds only the children of the root.
        if exact.is_empty() {
            continue;
        }
        let mut sorted = exact.clone();
        sorted.sort_by(f64::total_cmp);
        let mean = exact.iter().sum::<f64>() / exact.len() as f64;
        let std = (exact.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (exact.len() - 1) as f64).sqrt();
        let quantity = statistics.statistics;
        assert_eq!(quantity.count, 400, "{name}");
        assert!(is_close(quantity.mean, mean), "{name}: {} {mean}", quantity.mean);
        assert!((quantity.std.expect("many") - std).abs() <= 1e-9 * mean.abs(), "{name}");
        assert_eq!((quantity.min, quantity.max), (sorted[0], sorted[399]), "{name}");
        for (q, quantile) in [(0.5, Some(quantity.p50)), (0.95, quantity.p95), (0.99, quantity.p99)] {
            let exact = sorted[(q * 399.0_f64).round() as usize];
            let quantile = quantile.expect("enough values");
            // The error of a sketch is at most 1 %; the remaining tolerance is for rounding.
            assert!((quantile - exact).abs() <= 0.0101 * exact.abs(), "{name} at {q}: {quantile} {exact}");
        }
    }
    let names: Vec<&str> = stages.iter().map(|statistics| statistics.stage.as_str()).collect();
    assert_eq!(&names[..4], ["sensing", "capture", "transform", "encode"]);
    assert!(names.contains(&"total") && !names.contains(&"tokens-per-second"));
    let upload = stages.iter().find(|statistics| statistics.stage == "upload").expect("there");
    let bound = upload.bound.as_ref().expect("judged");
    assert!(is_close(bound.half_width.expect("bounded").mean, 40e-6));
    assert_eq!(bound.verdicts, [(peernet_clock::Verdict::Limited, 400)]);
    assert!(test_store.store.statistics_of(1).await.expect("answers").bounds.contains(bound));
    let total_share: f64 = stages
        .iter()
        .filter(|statistics| statistics.is_stage)
        .filter_map(|statistics| statistics.share)
        .sum();
    assert!(is_close(total_share, 1.0), "{total_share}");
}

#[tokio::test]
async fn stored_numbers_are_positions_of_values() {
    let test_store = TestStore::new().await;
    let pool = test_store.store.readers.pool();
    let names = async |statement: &'static str| -> Vec<String> {
        sqlx::query_scalar(statement).fetch_all(&pool).await.expect("answers")
    };
    let outcomes = rows::Outcome::ALL.map(rows::Outcome::name);
    assert_eq!(names("SELECT text FROM outcome ORDER BY id").await, outcomes);
    let sources: Vec<&str> = DelaySource::ALL.iter().map(|source| source.name()).collect();
    assert_eq!(names("SELECT text FROM source ORDER BY id").await, sources);
    let verdicts: Vec<&str> = Verdict::ALL.iter().map(|verdict| verdict.name()).collect();
    assert_eq!(names("SELECT text FROM verdict ORDER BY id").await, verdicts);
}

#[tokio::test]
async fn runs_read_in_one_query_equal_single_runs() {
    let mut test_store = TestStore::new().await;
    for iterations in [40, 30, 20] {
        test_store.store_run(iterations).await;
    }
    let in_one_query = test_store.store.statistics(&[3, 9, 1, 2, 1]).await.expect("answers");
    let mut single_runs = Vec::new();
    for run in [3, 9, 1, 2, 1] {
        single_runs.push(test_store.store.statistics_of(run).await.expect("answers"));
    }
    assert_eq!(in_one_query, single_runs);
    let total = |statistics: &RunStatistics| {
        statistics.stages.iter().find(|stage| stage.stage == stage::TOTAL).map(|total| total.statistics.count)
    };
    let counts: Vec<Option<u64>> = in_one_query.iter().map(total).collect();
    assert_eq!(counts, [Some(20), None, Some(40), Some(30), Some(40)]);
    assert!(
        in_one_query[0].bounds.iter().any(|bound| bound.half_width.is_some() && !bound.verdicts.is_empty())
    );
    assert_eq!(in_one_query[1], RunStatistics::default(), "there is no such run");
    let listed = test_store.store.runs(&RunFilter::default()).await.expect("answers");
    let totals: Vec<Option<u64>> = listed.iter().map(|run| run.total.map(|total| total.count)).collect();
    assert_eq!(totals, [Some(20), Some(30), Some(40)], "each run has its own total");
}

#[tokio::test]
async fn warm_up_and_failures_are_stored_outside_statistics() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut numbers = generate::Numbers::new(1);
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    for n in 1..=6 {
        let mut iteration = generate::iteration(run, n, test_store.hosts(), &mut numbers);
        iteration.warm_up = n == 1;
        iteration.outcome = match n {
            3 => Outcome::Lost("connection broke".into()),
            4 => Outcome::Timeout("no answer within 5 s".into()),
            5 => Outcome::Failed("not a picture".into()),
            _ => Outcome::Ok,
        };
        events.push(Event::Iteration(iteration));
    }
    events.push(Event::RunEnded(RunEnded { run, ended: generate::at(9.0), reason: EndReason::Finished }));
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;

    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    let counts = detail.summary.counts;
    assert_eq!(
        (counts.ok, counts.failed, counts.lost, counts.timeout, detail.summary.warm_up),
        (2, 1, 1, 1, 1)
    );
    assert_eq!(detail.summary.total.expect("figures").count, 2);
    assert_eq!(
        (detail.summary.ended, detail.summary.reason),
        (Some(generate::at(9.0)), Some(EndReason::Finished))
    );
    assert_eq!(detail.summary.placement, generate::remote());
    assert_eq!(detail.facts[0], ("Sensor".to_owned(), "30 images".to_owned()));
    assert_eq!((detail.summary.pipeline.as_str(), detail.summary.host_name.as_str()), ("line", "edge"));

    let all = test_store.store.iterations(1, &IterationFilter::default()).await.expect("answers");
    assert_eq!(all.iter().map(|row| row.number).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6]);
    let filter = IterationFilter { failed_only: true, after: 3, limit: 10 };
    let failed_rows = test_store.store.iterations(1, &filter).await.expect("answers");
    let failures: Vec<_> =
        failed_rows.iter().map(|row| (row.number, row.outcome.name(), row.reason.as_deref())).collect();
    assert_eq!(
        failures,
        [(4, "timeout", Some("no answer within 5 s")), (5, "failed", Some("not a picture"))]
    );
    let lost = test_store.store.iteration(1, 3).await.expect("answers").expect("exists");
    assert_eq!((lost.rank, lost.previous, lost.next), (None, Some(2), Some(4)));
}

#[tokio::test]
async fn iteration_is_read_as_sent() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(20).await;
    let mut numbers = generate::Numbers::new(7);
    let sent: Vec<Iteration> =
        (1..=20).map(|n| generate::iteration(run, n, test_store.hosts(), &mut numbers)).collect();
    for iteration in &sent {
        let detail = test_store.store.iteration(1, iteration.number).await.expect("answers").expect("exists");
        assert_eq!(detail.tree, iteration.tree);
        let names: Vec<_> = detail.hosts.iter().flatten().map(|name| name.as_str().to_owned()).collect();
        assert_eq!(names, ["edge", "cloud"]);
        assert_eq!((detail.row.episode, detail.row.step), (iteration.episode, iteration.step));
    }
    assert_eq!(test_store.store.iteration(1, 21).await.expect("answers"), None);
    assert_eq!(test_store.store.iteration(2, 1).await.expect("answers"), None);
    assert_eq!(test_store.store.iteration(1, u64::MAX).await.expect("answers"), None);
}

#[tokio::test]
async fn slowest_iterations_come_first_with_causes() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(300).await;
    let mut totals: Vec<(f64, u64)> = values(&test_store, run, 300, "total").into_iter().zip(1..).collect();
    totals.sort_by(|a, b| b.0.total_cmp(&a.0));
    let slowest = test_store.store.slowest_iterations(1, 10).await.expect("answers");
    let numbers: Vec<u64> = slowest.iter().map(|row| row.number).collect();
    assert_eq!(numbers, totals.iter().take(10).map(|(_, number)| *number).collect::<Vec<_>>());
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    let median =
        |name: &Name| stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.statistics.p50);
    for row in &slowest {
        assert!(row.factor.expect("known") > 1.0);
        let excess = |(name, value): &(Name, f64)| value - median(name).expect("in the run");
        let mut excesses: Vec<f64> = row.stages.iter().map(excess).filter(|seconds| *seconds > 0.0).collect();
        excesses.sort_by(|a, b| b.total_cmp(a));
        let cause_excesses: Vec<f64> = row.causes.iter().map(Cause::excess).collect();
        assert!(
            cause_excesses
                .iter()
                .zip(&excesses)
                .all(|(cause_excess, excess)| is_close(*cause_excess, *excess)),
            "{row:?}"
        );
        // Causes are added until they explain 80 % of the time by which the iteration is slower than the median.
        let min_explained = 0.8 * (row.total.expect("known") - median(&stage::TOTAL).expect("in the run"));
        let explained: f64 = cause_excesses.iter().sum();
        assert!(explained >= min_explained || cause_excesses.len() == excesses.len(), "{row:?}");
        assert!(explained - cause_excesses.last().expect("something took longer") < min_explained, "{row:?}");
    }
    let first = test_store.store.iteration(1, numbers[0]).await.expect("answers").expect("exists");
    let tenth = test_store.store.iteration(1, numbers[9]).await.expect("answers").expect("exists");
    assert_eq!((first.rank, tenth.rank), (Some(1), Some(10)));
    assert_eq!((first.slower, first.faster), (None, Some(numbers[1])));
    assert_eq!((tenth.slower, tenth.faster), (Some(numbers[8]), Some(totals[10].1)));
    // Iterations with equal totals have a defined order, too.
    let mut other = test_store.second_connection().await;
    sqlx::query("UPDATE iteration SET total = 9 WHERE number IN (?1, ?2, ?3)")
        .bind(numbers[3].cast_signed())
        .bind(numbers[5].cast_signed())
        .bind(numbers[8].cast_signed())
        .execute(&mut other)
        .await
        .expect("changes");
    let order: Vec<u64> = test_store
        .store
        .slowest_iterations(1, 5)
        .await
        .expect("answers")
        .iter()
        .map(|row| row.number)
        .collect();
    for (index, number) in order.iter().enumerate().take(4) {
        let detail = test_store.store.iteration(1, *number).await.expect("answers").expect("exists");
        let slower = index.checked_sub(1).map(|index| order[index]);
        assert_eq!((detail.slower, detail.faster), (slower, Some(order[index + 1])), "{order:?}");
    }
}

#[tokio::test]
async fn series_adds_up_to_run_for_any_bucket_width() {
    let mut test_store = TestStore::new().await;
    // 1,000 iterations begin 0.2 s, 0.4 s … 200 s after the run's start: in 201 seconds and 21 buckets of 10 s.
    test_store.store_run(1_000).await;
    let names = [stage::UPLOAD, stage::TOTAL, "nonsense".into()];
    for (points, width) in [(201, 1), (200, 2), (100, 5), (21, 10), (8, 30), (4, 60), (1, 300)] {
        let series = test_store.store.series(1, &names, points).await.expect("answers");
        assert_eq!((series.bucket_s, series.stages.len()), (width, 2), "{points} points");
        for stage in &series.stages {
            assert!(stage.points.len() <= points);
            assert_eq!(stage.points.iter().map(|point| point.count).sum::<u64>(), 1_000);
            assert!(stage.points.iter().all(|point| point.at.unix_seconds() % i64::from(width) == 0));
            let mean = stage.points.iter().map(|p| p.mean * p.count as f64).sum::<f64>() / 1_000.0;
            let run =
                test_store.store.histogram(1, &stage.stage, 10).await.expect("answers").expect("exists");
            assert!(is_close(mean, run.statistics.mean));
        }
    }
}

#[tokio::test]
async fn histogram_counts_each_value_once() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(500).await;
    for (stage, bins) in [("upload", 40), ("total", 1), ("upload-bytes", 20), ("inference", 500)] {
        let histogram = test_store.store.histogram(1, stage, bins).await.expect("answers").expect("exists");
        assert!((1..=bins).contains(&histogram.counts.len()), "{stage}");
        assert_eq!(histogram.edges.len(), histogram.counts.len() + 1);
        let outside = histogram.below + histogram.beyond;
        assert_eq!(histogram.counts.iter().sum::<u64>() + outside, 500, "{stage}");
        assert!(histogram.edges.windows(2).all(|pair| pair[0] < pair[1]));
    }
    // The border between two bins divides the values correctly, within the sketch's error of 1 %.
    let histogram = test_store.store.histogram(1, "upload", 2).await.expect("answers").expect("exists");
    let exact =
        values(&test_store, run, 500, "upload").iter().filter(|value| **value < histogram.edges[1]).count()
            as u64;
    assert!(histogram.counts[0].abs_diff(exact) < 15, "{} {exact}", histogram.counts[0]);
    assert_eq!(test_store.store.histogram(1, "nonsense", 10).await.expect("answers"), None);
}

#[tokio::test]
async fn runs_are_listed_newest_first_in_pages() {
    let mut test_store = TestStore::new().await;
    for n in 0..5 {
        let pipeline = if n % 2 == 0 { "even" } else { "odd" };
        let work = test_store.batch(vec![generate::run_started(
            RunId::random(),
            pipeline,
            generate::at(f64::from(n)),
        )]);
        test_store.commit(&[work]).await;
    }
    let numbers = async |filter: RunFilter| {
        let runs = test_store.store.runs(&filter).await.expect("answers");
        runs.iter().map(|run| run.number).collect::<Vec<_>>()
    };
    assert_eq!(numbers(RunFilter::default()).await, [5, 4, 3, 2, 1]);
    assert_eq!(numbers(RunFilter { limit: 2, before: Some(4), ..RunFilter::default() }).await, [3, 2]);
    let odd = RunFilter { pipeline: "odd".parse().ok(), host: Some(test_store.edge), ..RunFilter::default() };
    assert_eq!(numbers(odd).await, [4, 2]);
    assert!(numbers(RunFilter { host: Some(test_store.cloud), ..RunFilter::default() }).await.is_empty());
    assert_eq!(test_store.store.run(6).await.expect("answers"), None);
}

#[tokio::test]
async fn run_with_clock_fault_is_marked_in_all_answers() {
    let mut test_store = TestStore::new().await;
    // Earlier versions named the fact "Rehearsal". "Rehearsals" is an unrelated fact.
    for fact in ["Clock fault", "Rehearsal of cloud", "Rehearsals"] {
        let Event::RunStarted(mut run) = generate::run_started(RunId::random(), "line", generate::at(0.0))
        else {
            panic!("the start of a run")
        };
        run.facts.push((fact.to_owned(), "offset +1000 ms".to_owned()));
        let work = test_store.batch(vec![Event::RunStarted(run)]);
        test_store.commit(&[work]).await;
    }
    let runs = test_store.store.runs(&RunFilter::default()).await.expect("answers");
    assert_eq!(runs.iter().map(|run| run.has_clock_fault).collect::<Vec<_>>(), [false, true, true]);
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert!(detail.summary.has_clock_fault);
}

#[tokio::test]
async fn listed_iterations_have_delays_or_their_sum() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(100).await;
    let mut numbers = generate::Numbers::new(7);
    let mut stepped = generate::iteration(run, 101, test_store.hosts(), &mut numbers);
    let nodes = ["upload", "download"].map(|name| stepped.tree.find(&[name]).expect("there").0);
    for node in nodes {
        let Some(Measure::Transit(transit)) = stepped.tree.measure_mut(node) else { panic!("a transit") };
        transit.delay = Some(OneWayDelay::stepped(Span::from_seconds(-5), DelaySource::None));
    }
    let total = stepped.tree.find(&["total"]).expect("there").0;
    if let Some(Measure::Timer(total)) = stepped.tree.measure_mut(total) {
        *total = Some(Span::from_seconds(10));
    }
    let unattributed_s = 0.001;
    let unattributed = Measure::Timer(Some(Span::from_seconds_f64(unattributed_s)));
    stepped.tree.add(NodeId::ROOT, stage::UNATTRIBUTED, Span::ZERO, unattributed);
    let work = test_store.batch(vec![Event::Iteration(stepped)]);
    test_store.commit(&[work]).await;

    let rows = test_store.store.iterations(1, &IterationFilter::default()).await.expect("answers");
    assert_eq!(rows.len(), 100);
    for row in &rows {
        let detail = test_store.store.iteration(1, row.number).await.expect("answers").expect("exists");
        assert_eq!((&detail.row, row.both_ways), (row, None));
        let names: Vec<_> = row.delays.iter().map(|delay| delay.stage.as_str().to_owned()).collect();
        assert_eq!(names, ["upload", "download"]);
        for delay in &row.delays {
            let node = detail.tree.find(&[&delay.stage]).expect("there").1;
            let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
            let sent = transit.delay.expect("judged");
            let (lo, hi) = delay.bounds.expect("bounds");
            assert!(is_close(lo, sent.bounds.expect("bounds").lo.seconds()) && lo <= hi);
            assert_eq!(
                (delay.raw, delay.source, delay.verdict),
                (sent.raw.seconds(), sent.source, sent.verdict)
            );
            assert_eq!(delay.value, sent.value.map(Span::seconds));
        }
    }
    let slowest = test_store.store.slowest_iterations(1, 1).await.expect("answers").remove(0);
    assert_eq!(slowest.number, 101);
    let both_ways = slowest.both_ways.expect("the single delays are unknown");
    let other_stages_s: f64 = slowest.stages.iter().map(|(_, seconds)| seconds).sum();
    assert!(is_close(other_stages_s + both_ways + unattributed_s, 10.0), "{slowest:?}");
    let cause = slowest.causes.first().expect("something took longer");
    assert_eq!((cause.name.as_str(), cause.value), ("upload + download", both_ways));
    let verdicts: Vec<_> =
        slowest.delays.iter().map(|delay| (delay.value, delay.bounds, delay.verdict)).collect();
    assert_eq!(verdicts, [(None, None, Verdict::Stepped); 2]);
}

#[tokio::test]
async fn incidents_are_in_order_of_time() {
    let mut test_store = TestStore::new().await;
    let unknown_host = HostId::random();
    let incident = |seconds: f64, text: &str, peer| {
        Event::Incident(Incident {
            at: generate::at(seconds),
            kind: IncidentKind::Disconnected,
            pipeline: "line".parse().ok(),
            run: None,
            peer,
            text: text.into(),
        })
    };
    let work = test_store.batch(vec![
        incident(2.0, "second", Some(test_store.cloud)),
        incident(3.0, "third", None),
        incident(1.0, "first, spooled", Some(unknown_host)),
    ]);
    test_store.commit(&[work]).await;
    let all = test_store.store.incidents(&IncidentFilter::newest(10)).await.expect("answers");
    assert_eq!(
        all.iter().map(|row| row.text.as_str()).collect::<Vec<_>>(),
        ["third", "second", "first, spooled"]
    );
    let peers = all.iter().map(|row| row.peer.clone()).collect::<Vec<_>>();
    assert_eq!(peers, [None, Some("cloud".to_owned()), Some(unknown_host.to_string())]);
    let page = IncidentFilter { before: Some(all[0].id), ..IncidentFilter::newest(1) };
    let page = test_store.store.incidents(&page).await.expect("answers");
    assert_eq!(page[0].text, "second");
    let count = async |kind: Option<&str>, host: Option<&str>| {
        let (kind, host) = (kind.map(str::to_owned), host.map(str::to_owned));
        let filter = IncidentFilter { kind, host, ..IncidentFilter::newest(10) };
        test_store.store.incidents(&filter).await.expect("answers").len()
    };
    let reporter = all[0].host_name.as_ref().map(ToString::to_string);
    let kind_counts = (count(Some("disconnected"), None).await, count(Some("gap"), None).await);
    assert_eq!(kind_counts, (3, 0));
    let host_counts = (count(None, reporter.as_deref()).await, count(None, Some("nobody")).await);
    assert_eq!(host_counts, (3, 0));
}

#[tokio::test]
async fn views_answer_queries_of_sqlite_shell() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(5).await;
    let stages = "SELECT count(*) FROM stage_ms WHERE run = 1 AND iteration = 3 AND name = 'upload' AND ms > 1 \
                  AND hi_ms > ms AND verdict = 'limited'";
    assert_eq!(test_store.count(stages).await, 1);
    let statistics =
        "SELECT count FROM stage_statistics WHERE run = 1 AND name = 'total' AND unit = 's' AND variance > 0";
    assert_eq!(test_store.count(statistics).await, 5);
    let runs = "SELECT ok FROM run_list WHERE host = 'edge' AND pipeline = 'line' AND started_utc = '2025-01-01 00:00:00'";
    assert_eq!(test_store.count(runs).await, 5);
}

#[test]
fn merged_summary_equals_summary_of_whole() {
    let mut numbers = generate::Numbers::new(3);
    let (mut whole, mut merged) = (Summary::default(), Summary::default());
    for _ in 0..20 {
        let mut part = Summary::default();
        for _ in 0..50 {
            let value = numbers.between(1_000, 9_000_000) as f64 * 1e-9;
            whole.record(value);
            part.record(value);
        }
        merged.merge(&part);
    }
    let (whole, merged) = (
        QuantityStatistics::from_summary(&whole).expect("has values"),
        QuantityStatistics::from_summary(&merged).expect("has values"),
    );
    assert_eq!(
        (whole.count, whole.p50, whole.p95, whole.max),
        (merged.count, merged.p50, merged.p95, merged.max)
    );
    assert!(is_close(whole.mean, merged.mean));
}

#[tokio::test]
async fn host_seen_last_is_first_of_its_name() {
    let mut test_store = TestStore::new().await;
    let successor = HostId::random();
    let work = [hello(generate::host(successor, "edge"), 1)];
    test_store.writer.commit(&work, STAMP + Span::from_seconds(60)).await.expect("commits");
    let hosts = test_store.store.hosts().await.expect("answers");
    let hosts: Vec<_> = hosts.iter().map(|host| (host.name.as_str(), host.id)).collect();
    let edge = test_store.edge;
    assert_eq!(hosts, [("cloud", test_store.cloud), ("edge", successor), ("edge", edge)]);
    for (name_or_id, expected) in [("edge", successor), (&*edge.to_string(), edge)] {
        let host = test_store.store.host(name_or_id).await.expect("answers");
        assert_eq!(host.map(|host| host.id), Some(expected), "{name_or_id}");
    }
}
