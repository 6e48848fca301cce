//! Runs whose agent was killed, runs whose start is not stored, and gaps that quarantined batches leave.

use peernet_logger::RunId;
use peernet_stream::{BatchHead, EndReason, Event, RunEnded, codec};

use super::{NOW, STAMP, TestStore, Work, generate, open};
use crate::write::{LiveRunDescription, UnstorableBatch, read_host_counts, read_runs_without_start};

const END_WITHOUT_REPORT: &str = "the agent ended without saying so";

fn iterations(test_store: &TestStore, run: RunId, numbers: std::ops::RangeInclusive<u64>) -> Vec<Event> {
    let mut random = generate::Numbers::new(*numbers.start());
    numbers.map(|n| Event::Iteration(generate::iteration(run, n, test_store.hosts(), &mut random))).collect()
}

fn hello(test_store: &TestStore, process: u64) -> Work {
    super::hello(generate::host(test_store.edge, "edge"), process)
}

/// Returns the time, in seconds, and the reason of the end of each run; `None` for a run that has
/// not ended. The assumed end of a run is the start of its last iteration, or the start of the run
/// if it has no iteration. Iteration n starts at n / 5 seconds.
async fn run_ends(test_store: &TestStore) -> Vec<Option<(f64, String)>> {
    let mut runs = test_store.store.runs(&crate::RunFilter::default()).await.expect("answers");
    runs.reverse();
    let end = |ended: peernet_clock::WallTime| (ended - generate::at(0.0)).seconds();
    runs.into_iter().map(|run| Some((end(run.ended?), run.reason?.to_string()))).collect()
}

#[tokio::test]
async fn only_new_process_ends_runs_of_previous_process() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(10).await;
    let (repeated_hello, after_restart) = (hello(&test_store, 1), hello(&test_store, 1));
    test_store.commit(&[repeated_hello]).await;
    test_store.writer = open(&test_store.path).await;
    test_store.commit(&[after_restart]).await;
    assert_eq!(run_ends(&test_store).await, [None]);

    // One transaction holds the hello of the next process and the first run of that process.
    let (hello_of_next, run) = (hello(&test_store, u64::MAX), RunId::random());
    let run_started = test_store.batch(vec![generate::run_started(run, "other", NOW)]);
    test_store.commit(&[hello_of_next, run_started]).await;
    assert_eq!(run_ends(&test_store).await, [Some((2.0, END_WITHOUT_REPORT.to_owned())), None]);
}

#[tokio::test]
async fn goodbye_ends_open_runs() {
    let mut test_store = TestStore::new().await;
    let first = test_store.store_run(10).await;
    // The goodbye of another host does not end the run.
    test_store.commit(&[Work::Goodbye(test_store.cloud)]).await;
    assert_eq!(run_ends(&test_store).await, [None]);
    let end = RunEnded { run: first, ended: generate::at(9.0), reason: EndReason::Stopped };
    let ended = test_store.batch(vec![Event::RunEnded(end)]);
    let run_started =
        test_store.batch(vec![generate::run_started(RunId::random(), "line", generate::at(10.0))]);
    test_store.commit(&[ended, run_started, Work::Goodbye(test_store.edge)]).await;
    assert_eq!(
        run_ends(&test_store).await,
        [Some((9.0, "stopped".to_owned())), Some((10.0, END_WITHOUT_REPORT.to_owned()))]
    );
}

#[tokio::test]
async fn new_run_of_pipeline_ends_previous_one() {
    let mut test_store = TestStore::new().await;
    let first = test_store.store_run(10).await;
    let (second, other) = (RunId::random(), RunId::random());
    // The start of the second run arrives twice. The repeated start does not end the second run.
    let run_started = test_store.batch(vec![
        generate::run_started(other, "other", NOW),
        generate::run_started(second, "line", NOW),
        generate::run_started(second, "line", NOW),
    ]);
    test_store.commit(&[run_started]).await;
    assert_eq!(run_ends(&test_store).await, [Some((2.0, END_WITHOUT_REPORT.to_owned())), None, None]);

    // Late iterations are stored and move the assumed end. A reported end replaces the assumed end and is not moved.
    let late_iterations = iterations(&test_store, first, 11..=15);
    let late_batch = test_store.batch(late_iterations);
    test_store.commit(&[late_batch]).await;
    assert_eq!(run_ends(&test_store).await[0], Some((3.0, END_WITHOUT_REPORT.to_owned())));
    assert_eq!(test_store.count("SELECT ok FROM run WHERE number = 1").await, 15);
    let end = RunEnded { run: first, ended: generate::at(2.5), reason: EndReason::Stopped };
    let iteration_after_end = iterations(&test_store, first, 16..=16);
    let reported_end = test_store.batch(vec![Event::RunEnded(end)]);
    let iteration_after_end = test_store.batch(iteration_after_end);
    test_store.commit(&[reported_end, iteration_after_end]).await;
    assert_eq!(run_ends(&test_store).await[0], Some((2.5, "stopped".to_owned())));
}

#[tokio::test]
async fn run_without_start_is_described_once_by_own_host() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let events = iterations(&test_store, run, 4..=6);
    let work = test_store.batch(events);
    assert_eq!(test_store.commit(&[work]).await.runs_without_start, [(test_store.edge, run)]);
    let mut connection = crate::database::open(&test_store.path).await.expect("opens");
    assert_eq!(read_runs_without_start(&mut connection, 10).await.expect("reads"), [(test_store.edge, run)]);

    let description = |host, pipeline: &str| {
        let pipeline = pipeline.parse().expect("a name");
        Work::LiveDescription(Box::new(LiveRunDescription {
            host,
            run,
            pipeline,
            placement: generate::remote(),
        }))
    };
    let by_other_host = description(test_store.cloud, "stolen");
    let first = description(test_store.edge, "line");
    let (second, unknown_run) = (description(test_store.edge, "later"), RunId::random());
    let of_unknown_run = Work::LiveDescription(Box::new(LiveRunDescription {
        host: test_store.edge,
        run: unknown_run,
        pipeline: "line".parse().expect("a name"),
        placement: generate::remote(),
    }));
    test_store.commit(&[by_other_host, first]).await;
    test_store.commit(&[second, of_unknown_run]).await;
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((detail.summary.pipeline.as_str(), &detail.summary.placement), ("line", &generate::remote()));
    assert_eq!(test_store.count("SELECT count(*) FROM run").await, 1);
    assert!(read_runs_without_start(&mut connection, 10).await.expect("reads").is_empty());
}

#[tokio::test]
async fn events_of_quarantined_batches_count_as_missing() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(5).await;
    // A batch that holds one iteration three times, a truncated batch, and a truncated batch whose head claims more
    // events than the batch has bytes. The number of missing events of the last batch is unknown, which is stored as 0.
    let repeated = [6, 6, 6].map(|n| iterations(&test_store, run, n..=n)).concat();
    let repeated = test_store.batch(repeated);
    let mut unreadable = |events: u32| {
        let body = generate::body(&vec![generate::run_started(run, "line", NOW); 2]);
        let number = test_store.next_number;
        test_store.next_number += 1;
        let head = BatchHead { events, ..test_store.head(number, &body, 2) };
        let compress = false;
        let mut frame = codec::encode_batch(&head, &body, compress);
        frame.truncate(frame.len() / 2);
        let reason = "cut off".into();
        Work::UnstorableBatch(Box::new(UnstorableBatch { head, frame: frame.into(), body: None, reason }))
    };
    let (truncated, impossible_count) = (unreadable(2), unreadable(u32::MAX));
    let committed = test_store.commit(&[repeated, truncated, impossible_count]).await;
    assert_eq!(committed.quarantined.len(), 3);
    let (stored, _) = committed.hosts[&test_store.edge];
    assert_eq!((stored.quarantined, stored.gaps, stored.missing), (3, 3, 5));
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((detail.gaps.len(), detail.gaps[0].count), (1, 3));
    assert!(detail.gaps[0].reason.starts_with("a batch was quarantined: "), "{}", detail.gaps[0].reason);
    assert_eq!(test_store.count("SELECT count(*) FROM gap WHERE run IS NULL AND count = 0").await, 1);

    let mut connection = crate::database::open(&test_store.path).await.expect("opens");
    let hosts = read_host_counts(&mut connection, 10).await.expect("reads");
    let stored_counts = hosts.iter().find(|(host, _)| *host == test_store.edge).map(|(_, stored)| *stored);
    assert_eq!(stored_counts, Some(stored));
}

#[tokio::test]
async fn commit_to_moved_file_is_refused() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let work = [test_store.batch(vec![generate::run_started(run, "line", NOW)])];
    let elsewhere = test_store.path.with_extension("away");
    std::fs::rename(&test_store.path, &elsewhere).expect("moves");
    let refused = test_store.writer.commit(&work, STAMP).await.expect_err("moved").to_string();
    assert!(
        refused.contains("was deleted, moved or replaced") && refused.contains("put it back"),
        "{refused}"
    );
    std::fs::write(&test_store.path, "another file").expect("writes");
    assert!(test_store.writer.check_file().is_err());
    std::fs::rename(&elsewhere, &test_store.path).expect("moves back");
    assert_eq!(test_store.commit(&work).await.marks[&test_store.stream].stored, 1);
    assert_eq!(test_store.count("SELECT count(*) FROM run").await, 1);
}
