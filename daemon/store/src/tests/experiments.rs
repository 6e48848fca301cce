//! Runs of an experiment, and the conditions of their hosts.

use peernet_analysis::compare::needs_column;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::{HostRecord, RunRecord, to_utc};
use peernet_analysis::rows::{Rows, Units};
use peernet_analysis::run_selection::{Candidate, Exclusion, RunState, exclusions};
use peernet_clock::Span;
use peernet_logger::stage;
use peernet_logger::{Name, RunId};
use peernet_stream::{Condition, Event, ExperimentPosition, Grade, RunDescription, RunEnded};

use super::{TestStore, generate};
use crate::types::{MeanBucket, RunFilter, RunSummary};

fn experiment_position(id: &str, size: &str, repeat: u32) -> ExperimentPosition {
    ExperimentPosition {
        name: "sizes".to_owned(),
        id: id.to_owned(),
        configuration: vec![("size".to_owned(), size.to_owned()), ("where".to_owned(), "cloud".to_owned())],
        repeat,
        configuration_index: Some(3),
        edges: Some(1),
    }
}

fn conditions() -> Vec<Condition> {
    vec![Condition {
        host: "edge".to_owned(),
        about: "CPU governor".to_owned(),
        found: "schedutil, \"quoted\"".to_owned(),
        grade: Grade::Doubtful,
        advice: "set it".to_owned(),
    }]
}

fn run_started(experiment: Option<ExperimentPosition>, conditions: Vec<Condition>) -> Event {
    let Event::RunStarted(run) = generate::run_started(RunId::random(), "line", generate::at(0.0)) else {
        panic!("a run begins")
    };
    Event::RunStarted(RunDescription { experiment: experiment.map(Box::new), conditions, ..run })
}

#[tokio::test]
async fn run_is_stored_with_experiment_and_host_conditions() {
    let mut test_store = TestStore::new().await;
    let work = test_store.batch(vec![
        run_started(Some(experiment_position("a", "1 kB", 2)), conditions()),
        run_started(None, Vec::new()),
    ]);
    test_store.commit(&[work]).await;
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(
        (detail.summary.experiment, detail.conditions),
        (Some(experiment_position("a", "1 kB", 2)), conditions())
    );
    let detail_without_experiment = test_store.store.run(2).await.expect("answers").expect("exists");
    assert_eq!(
        (detail_without_experiment.summary.experiment, detail_without_experiment.conditions),
        (None, Vec::new())
    );
    let listed = test_store.store.runs(&RunFilter::default()).await.expect("answers");
    assert_eq!(listed.iter().filter(|run| run.experiment.is_some()).count(), 1);
}

#[tokio::test]
async fn experiments_are_listed_with_their_runs() {
    let mut test_store = TestStore::new().await;
    assert!(test_store.store.experiments(10).await.expect("answers").is_empty());
    let events = vec![
        run_started(Some(experiment_position("a", "1 kB", 0)), Vec::new()),
        run_started(Some(experiment_position("b", "1 kB", 0)), Vec::new()),
        run_started(None, Vec::new()),
        run_started(Some(experiment_position("a", "2 kB", 0)), Vec::new()),
    ];
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    let listed = test_store.store.experiments(10).await.expect("answers");
    let listed_experiments: Vec<_> = listed
        .iter()
        .map(|item| (item.id.as_str(), item.runs, item.open, item.first_run, item.last_run))
        .collect();
    // When a pipeline begins a run, its previous run ends.
    assert_eq!(listed_experiments, [("a", 2, 1, 1, 4), ("b", 1, 0, 2, 2)]);
    assert_eq!(listed[0].name, "sizes");
    let runs = test_store.store.runs_of_experiment("a", 10).await.expect("answers");
    assert_eq!(runs.iter().map(|run| run.number).collect::<Vec<_>>(), [1, 4]);
    assert_eq!(test_store.store.runs_of_experiment("a", 1).await.expect("answers").len(), 1);
    assert!(test_store.store.runs_of_experiment("' OR 1", 10).await.expect("answers").is_empty());
}

/// Returns the results of a stored run as they are read from files.
fn results_in_files(run: &RunSummary, rows: Rows) -> Loaded {
    Loaded {
        folder: format!("runs/{}", run.number).into(),
        record: RunRecord {
            run: Some(run.id),
            name: run.pipeline.to_string(),
            // Some runs of the tests start at one time. Runs of files are ordered by their starts, runs of the store by
            // their numbers.
            started: Some(to_utc(run.started + Span::from_nanos(run.number))),
            ended: run.ended.map(to_utc),
            reason: run.reason.clone().unwrap_or_default(),
            edge: HostRecord { id: Some(run.host), ..HostRecord::default() },
            experiment: run.experiment.clone(),
            ..RunRecord::default()
        },
        rows,
    }
}

#[tokio::test]
async fn same_runs_are_excluded_in_store_and_in_files() {
    let mut test_store = TestStore::new().await;
    // The size `1 kB` is measured twice. The first run of `2 kB` is stopped, and the second run is complete. The run of
    // `3 kB` fails, only one of two edges measures `4 kB`, and the run of `5 kB` is in progress.
    let plan = [
        ("1 kB", Some("finished")),
        ("2 kB", Some("stopped")),
        ("2 kB", Some("finished")),
        ("1 kB", Some("finished")),
        ("3 kB", Some("the server went")),
        ("4 kB", Some("finished")),
        ("5 kB", None),
    ];
    for (index, (size, reason)) in plan.iter().enumerate() {
        let edges = Some(if *size == "4 kB" { 2 } else { 1 });
        let position = ExperimentPosition { edges, ..experiment_position("a", size, 0) };
        let run_started = run_started(Some(position), Vec::new());
        let Event::RunStarted(RunDescription { run, .. }) = &run_started else { panic!("a run begins") };
        let ended = generate::at(index as f64 + 1.0);
        let end = reason.map(|reason| Event::RunEnded(RunEnded { run: *run, ended, reason: reason.into() }));
        let work = test_store.batch([run_started].into_iter().chain(end).collect());
        test_store.commit(&[work]).await;
    }
    let stored = test_store.store.runs_of_experiment("a", 10).await.expect("answers");
    let exclusions_in_store = exclusions(&stored.iter().map(Candidate::from).collect::<Vec<_>>());
    let files: Vec<Loaded> = stored.iter().map(|run| results_in_files(run, Rows::default())).collect();
    let exclusions_in_files = exclusions(&files.iter().map(Candidate::from_results).collect::<Vec<_>>());
    assert_eq!(exclusions_in_store, exclusions_in_files);
    let name = |index: usize| format!("#{}", stored[index].number);
    let descriptions: Vec<Option<String>> =
        exclusions_in_store.iter().map(|exclusion| Some(exclusion.as_ref()?.describe(name))).collect();
    let expected = [
        Some("measured again as #4"),
        Some("interrupted"),
        None,
        None,
        Some("failed (the server went)"),
        Some("measured by only 1 of 2 edges"),
        Some("in progress or killed"),
    ];
    assert_eq!(descriptions.iter().map(Option::as_deref).collect::<Vec<_>>(), expected);
}

#[tokio::test]
async fn run_without_end_overlaps_until_last_iteration() {
    let mut test_store = TestStore::new().await;
    // Two pipelines measure one repeat. The first breaks off after 30 s, and its end is not recorded.
    let [first, second] = [("first", 0.0), ("second", 1.0)].map(|(pipeline, started)| {
        let event = generate::run_started(RunId::random(), pipeline, generate::at(started));
        let Event::RunStarted(run) = event else { panic!("a run begins") };
        RunDescription { experiment: Some(Box::new(experiment_position("a", "1 kB", 0))), ..run }
    });
    let (hosts, mut numbers) = (test_store.hosts(), generate::Numbers::new(7));
    let last = generate::iteration_at(first.run, 150, hosts, generate::at(30.0), &mut numbers);
    let rows: Rows = [Units::default().row(&last)].into_iter().collect();
    let end = RunEnded { run: second.run, ended: generate::at(60.0), reason: "finished".into() };
    let events = [Event::RunStarted(first), Event::RunStarted(second), Event::Iteration(last)];
    let work = test_store.batch(events.into_iter().chain([Event::RunEnded(end)]).collect());
    test_store.commit(&[work]).await;
    let stored = test_store.store.runs_of_experiment("a", 10).await.expect("answers");
    let exclusions_in_store = exclusions(&stored.iter().map(Candidate::from).collect::<Vec<_>>());
    let files = [results_in_files(&stored[0], rows), results_in_files(&stored[1], Rows::default())];
    let exclusions_in_files = exclusions(&files.iter().map(Candidate::from_results).collect::<Vec<_>>());
    assert_eq!(exclusions_in_store, exclusions_in_files);
    let expected = [Exclusion::Unfinished(RunState::Open), Exclusion::ConcurrentRunUnfinished(0)];
    assert_eq!(exclusions_in_store, expected.map(Some));
    // In files, the last iteration is found by the column `at`.
    assert!(needs_column("at"), "a comparison reads only the columns that it needs");
}

#[tokio::test]
async fn stage_buckets_hold_all_values() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(500).await;
    let names = [stage::TOTAL, Name::from_static("nothing"), stage::UPLOAD];
    let stages = test_store.store.stage_buckets(1, &names, 20).await.expect("answers");
    assert_eq!(stages.iter().map(|item| item.stage.as_str()).collect::<Vec<_>>(), ["total", "upload"]);
    let whole = test_store.store.statistics_of(1).await.expect("answers").stages;
    for stage in stages {
        assert!((5..=20).contains(&stage.buckets.len()), "{}", stage.buckets.len());
        let expected =
            whole.iter().find(|statistics| statistics.stage == stage.stage).expect("known").statistics;
        assert_eq!(stage.buckets.iter().map(|bucket| bucket.count()).sum::<u64>(), expected.count);
        let max = stage.buckets.iter().map(|bucket| bucket.moments.max).fold(0.0, f64::max);
        assert_eq!((max, stage.unit.as_str()), (expected.max, "s"));
    }
}

#[tokio::test]
async fn stage_means_match_stage_buckets() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(500).await;
    let names = [stage::TOTAL, Name::from_static("nothing"), stage::UPLOAD];
    for max_buckets in [1, 7, 20, 1_000] {
        let stages = test_store.store.stage_buckets(1, &names, max_buckets).await.expect("answers");
        let means = test_store.store.stage_means(1, &names, max_buckets).await.expect("answers");
        assert_eq!(means.len(), stages.len(), "{means:?}");
        for (means, stage) in means.iter().zip(&stages) {
            assert_eq!((&means.stage, means.buckets.len()), (&stage.stage, stage.buckets.len()));
            for (MeanBucket { count, mean, .. }, bucket) in means.buckets.iter().zip(&stage.buckets) {
                let is_close = (mean - bucket.moments.mean).abs() <= 1e-12 * mean.abs();
                assert!(*count == bucket.count() && is_close, "{mean} {:?}", bucket.moments);
            }
        }
    }
}
