//! Runs that were declared together, and what was found of their hosts.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::{HostRecord, RunRecord, to_utc};
use peernet_analysis::rows::Rows;
use peernet_analysis::run_selection::{Candidate, exclusions};
use peernet_clock::Span;
use peernet_logger::stage;
use peernet_logger::{Name, RunId};
use peernet_stream::{Condition, Event, ExperimentPlace, Grade, RunDescription, RunEnded};

use super::{TestStore, generate};
use crate::types::{MeanBucket, RunFilter, RunSummary};

fn experiment_place(id: &str, size: &str, repeat: u32) -> ExperimentPlace {
    ExperimentPlace {
        name: "sizes".to_owned(),
        id: id.to_owned(),
        configuration: vec![("size".to_owned(), size.to_owned()), ("where".to_owned(), "cloud".to_owned())],
        repeat,
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

fn began(experiment: Option<ExperimentPlace>, conditions: Vec<Condition>) -> Event {
    let Event::RunStarted(run) = generate::run_started(RunId::random(), "line", generate::at(0.0)) else {
        panic!("a run begins")
    };
    Event::RunStarted(RunDescription { experiment: experiment.map(Box::new), conditions, ..run })
}

#[tokio::test]
async fn a_run_knows_its_experiment_and_what_was_found_of_its_hosts() {
    let mut test_store = TestStore::new().await;
    let work = test_store
        .batch(vec![began(Some(experiment_place("a", "1 kB", 2)), conditions()), began(None, Vec::new())]);
    test_store.commit(&[work]).await;
    let of = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(
        (of.summary.experiment, of.conditions),
        (Some(experiment_place("a", "1 kB", 2)), conditions())
    );
    let alone = test_store.store.run(2).await.expect("answers").expect("exists");
    assert_eq!((alone.summary.experiment, alone.conditions), (None, Vec::new()));
    let listed = test_store.store.runs(&RunFilter::default()).await.expect("answers");
    assert_eq!(listed.iter().filter(|run| run.experiment.is_some()).count(), 1);
}

#[tokio::test]
async fn experiments_are_listed_with_their_runs() {
    let mut test_store = TestStore::new().await;
    assert!(test_store.store.experiments(10).await.expect("answers").is_empty());
    let events = vec![
        began(Some(experiment_place("a", "1 kB", 0)), Vec::new()),
        began(Some(experiment_place("b", "1 kB", 0)), Vec::new()),
        began(None, Vec::new()),
        began(Some(experiment_place("a", "2 kB", 0)), Vec::new()),
    ];
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    let listed = test_store.store.experiments(10).await.expect("answers");
    let told: Vec<_> =
        listed.iter().map(|it| (it.id.as_str(), it.runs, it.open, it.oldest, it.newest)).collect();
    // A pipeline that begins a run has ended the one before.
    assert_eq!(told, [("a", 2, 1, 1, 4), ("b", 1, 0, 2, 2)]);
    assert_eq!(listed[0].name, "sizes");
    let runs = test_store.store.runs_of_experiment("a", 10).await.expect("answers");
    assert_eq!(runs.iter().map(|run| run.number).collect::<Vec<_>>(), [1, 4]);
    assert_eq!(test_store.store.runs_of_experiment("a", 1).await.expect("answers").len(), 1);
    assert!(test_store.store.runs_of_experiment("' OR 1", 10).await.expect("answers").is_empty());
}

#[tokio::test]
async fn same_runs_count_in_store_and_in_files() {
    let mut test_store = TestStore::new().await;
    // The same repeat twice; a repeat that was stopped and started again, one that failed, and one in progress.
    let plan = [
        ("1 kB", Some("finished")),
        ("2 kB", Some("stopped")),
        ("2 kB", Some("finished")),
        ("1 kB", Some("finished")),
        ("3 kB", Some("the server went")),
        ("4 kB", None),
    ];
    for (at, (size, reason)) in plan.iter().enumerate() {
        let began = began(Some(experiment_place("a", size, 0)), Vec::new());
        let Event::RunStarted(RunDescription { run, .. }) = &began else { panic!("a run begins") };
        let at = generate::at(at as f64 + 1.0);
        let end =
            reason.map(|reason| Event::RunEnded(RunEnded { run: *run, ended: at, reason: reason.into() }));
        let work = test_store.batch([began].into_iter().chain(end).collect());
        test_store.commit(&[work]).await;
    }
    let stored = test_store.store.runs_of_experiment("a", 10).await.expect("answers");
    let results = |run: &RunSummary| Loaded {
        folder: format!("runs/{}", run.number).into(),
        record: RunRecord {
            run: Some(run.id),
            name: run.pipeline.to_string(),
            started: Some(to_utc(run.started + Span::from_nanos(run.number))),
            reason: run.reason.clone().unwrap_or_default(),
            edge: HostRecord { id: Some(run.host), ..HostRecord::default() },
            experiment: run.experiment.clone(),
            ..RunRecord::default()
        },
        rows: Rows::default(),
    };
    let of_store = exclusions(&stored.iter().map(Candidate::from).collect::<Vec<_>>());
    let files: Vec<Loaded> = stored.iter().map(results).collect();
    let of_files = exclusions(&files.iter().map(Candidate::from_results).collect::<Vec<_>>());
    assert_eq!(of_store, of_files);
    let name = |at: usize| format!("#{}", stored[at].number);
    let said: Vec<Option<String>> = of_store.iter().map(|why| Some(why.as_ref()?.describe(name))).collect();
    let expected = [
        Some("measured again as #4"),
        Some("interrupted"),
        None,
        None,
        Some("failed (the server went)"),
        Some("in progress or killed"),
    ];
    assert_eq!(said.iter().map(Option::as_deref).collect::<Vec<_>>(), expected);
}

#[tokio::test]
async fn a_course_holds_every_sample_in_order_of_time() {
    let mut test_store = TestStore::new().await;
    test_store.run_of(500).await;
    let asked = [stage::TOTAL, Name::from_static("nothing"), stage::UPLOAD];
    let courses = test_store.store.stage_buckets(1, &asked, 20).await.expect("answers");
    assert_eq!(courses.iter().map(|it| it.stage.as_str()).collect::<Vec<_>>(), ["total", "upload"]);
    let whole = test_store.store.statistics_of(1).await.expect("answers").stages;
    for course in courses {
        assert!((5..=20).contains(&course.buckets.len()), "{}", course.buckets.len());
        let figures = whole.iter().find(|known| known.stage == course.stage).expect("known").figures;
        assert_eq!(course.buckets.iter().map(|bucket| bucket.count()).sum::<u64>(), figures.count);
        let max = course.buckets.iter().map(|bucket| bucket.moments.max).fold(0.0, f64::max);
        assert_eq!((max, course.unit.as_str()), (figures.max, "s"));
    }
}

#[tokio::test]
async fn means_are_those_of_the_course() {
    let mut test_store = TestStore::new().await;
    test_store.run_of(500).await;
    let asked = [stage::TOTAL, Name::from_static("nothing"), stage::UPLOAD];
    for most in [1, 7, 20, 1_000] {
        let courses = test_store.store.stage_buckets(1, &asked, most).await.expect("answers");
        let means = test_store.store.stage_means(1, &asked, most).await.expect("answers");
        assert_eq!(means.len(), courses.len(), "{means:?}");
        for (means, course) in means.iter().zip(&courses) {
            assert_eq!((&means.stage, means.buckets.len()), (&course.stage, course.buckets.len()));
            for (MeanBucket { count, mean, .. }, bucket) in means.buckets.iter().zip(&course.buckets) {
                let same = (mean - bucket.moments.mean).abs() <= 1e-12 * mean.abs();
                assert!(*count == bucket.count() && same, "{mean} {:?}", bucket.moments);
            }
        }
    }
}
