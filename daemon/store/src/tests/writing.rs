//! Promises of the writer: each batch is stored exactly once, an invalid batch is quarantined, and no batch is stored
//! in part.

use peernet_analysis::trust::MissingCount;
use peernet_logger::{HostId, RunId};
use peernet_stream::{
    ChainHash, Event, Gap, Hello, HighWaterMark, Iteration, MissingBatches, MissingPreviousBatches,
    STREAM_VERSIONS, StreamId, StreamRecord,
};

use super::rollups::{assert_same, read_rollups};
use super::{NOW, STAMP, TestStore, Work, generate, hello, open};
use crate::rebuild::rebuild;
use crate::stored::StoredCounts;
use crate::write::{Introduction, UnstorableBatch};

fn iterations(test_store: &TestStore, run: RunId, numbers: std::ops::RangeInclusive<u64>) -> Vec<Event> {
    let mut random = generate::Numbers::new(*numbers.start());
    numbers.map(|n| Event::Iteration(generate::iteration(run, n, test_store.hosts(), &mut random))).collect()
}

/// Number of iterations in the statistics of whole runs.
const ITERATIONS_IN_STATISTICS: &str = "SELECT count FROM rollup JOIN name ON name.id = rollup.name \
     WHERE resolution_s = 0 AND quantity = 0 AND text = 'total'";

#[tokio::test]
async fn repeated_batch_is_stored_once() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut events = vec![generate::run_started(run, "line", NOW)];
    events.extend(iterations(&test_store, run, 1..=10));
    let work = test_store.batch_numbered(1, events.clone());
    let repeated = test_store.batch_numbered(1, events.clone());
    // The batch arrives twice in one transaction, then in a second transaction, then at another writer process. Each of
    // its ten iterations has 21 nodes.
    let committed = test_store.commit(&[work, repeated]).await;
    assert_eq!((committed.marks[&test_store.stream].stored, committed.nodes), (1, 210));
    let repeated = test_store.batch_numbered(1, events.clone());
    assert_eq!(test_store.commit(&[repeated]).await.marks[&test_store.stream].stored, 1);
    test_store.writer = open(&test_store.path).await;
    let mark = test_store.writer.streams().marks[&test_store.stream];
    assert_eq!(mark, HighWaterMark::from(test_store.head(1, &generate::body(&events), 11)));
    let repeated = test_store.batch_numbered(1, events);
    let committed = test_store.commit(&[repeated]).await;
    assert_eq!((committed.marks[&test_store.stream].stored, committed.nodes), (1, 0));

    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 210);
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 10);
    assert_eq!(test_store.count("SELECT ok FROM run").await, 10);
    assert_eq!(test_store.count("SELECT nodes FROM host WHERE name = 'edge'").await, 210);
    assert_eq!(test_store.count(ITERATIONS_IN_STATISTICS).await, 10);
}

#[tokio::test]
async fn rollups_do_not_depend_on_commits_and_restarts() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let started = generate::run_started(run, "line", NOW);
    let work = test_store.batch(vec![started]);
    test_store.commit(&[work]).await;
    for n in 0..10 {
        let events = iterations(&test_store, run, n * 20 + 1..=n * 20 + 20);
        let work = test_store.batch(events);
        test_store.commit(&[work]).await;
        if n % 3 == 0 {
            test_store.writer = open(&test_store.path).await;
        }
    }
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    // The same iterations in one commit.
    let mut single_commit_store = TestStore::new().await;
    (single_commit_store.edge, single_commit_store.cloud) = test_store.hosts();
    let mut events = vec![generate::run_started(run, "line", NOW)];
    for n in 0..10 {
        events.extend(iterations(&test_store, run, n * 20 + 1..=n * 20 + 20));
    }
    let work = single_commit_store.batch(events);
    single_commit_store.commit(&[work]).await;
    let stages_of_one_commit = single_commit_store.store.statistics_of(1).await.expect("answers").stages;
    assert_eq!(stages.len(), stages_of_one_commit.len());
    for (a, b) in stages.iter().zip(&stages_of_one_commit) {
        assert_eq!(
            (&a.stage, a.statistics.count, a.statistics.p50, a.statistics.p95),
            (&b.stage, b.statistics.count, b.statistics.p50, b.statistics.p95)
        );
        assert_eq!((a.statistics.min, a.statistics.max), (b.statistics.min, b.statistics.max));
        assert!((a.statistics.mean - b.statistics.mean).abs() <= 1e-9 * a.statistics.mean.abs());
        assert_eq!(
            a.bound.as_ref().map(|bound| &bound.verdicts),
            b.bound.as_ref().map(|bound| &bound.verdicts)
        );
    }
}

#[tokio::test]
async fn bad_batch_is_quarantined_and_others_are_stored() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let good = vec![generate::run_started(run, "line", NOW)];
    let first = iterations(&test_store, run, 1..=5);
    // Two batches are invalid: one has an iteration twice, the other an iteration that began on another host.
    let repeated_iterations =
        [iterations(&test_store, run, 6..=6), iterations(&test_store, run, 6..=6)].concat();
    let mut numbers = generate::Numbers::new(1);
    let foreign: Iteration = generate::iteration(run, 9, (HostId::random(), test_store.cloud), &mut numbers);
    let last = iterations(&test_store, run, 7..=8);
    let work: Vec<Work> = [good, first, repeated_iterations, vec![Event::Iteration(foreign)], last]
        .into_iter()
        .map(|events| test_store.batch(events))
        .collect();
    let committed = test_store.commit(&work).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 5);
    let quarantined: Vec<u64> = committed.quarantined.iter().map(|(head, _)| head.number).collect();
    assert_eq!(quarantined, [3, 4]);
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 7);
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 7 * 21);
    assert_eq!(test_store.count("SELECT ok FROM run").await, 7);
    assert_eq!(
        test_store
            .count("SELECT count(*) FROM quarantine WHERE length(frame) > 100 AND length(reason) > 10")
            .await,
        2
    );
    assert_eq!(test_store.count("SELECT quarantined FROM host WHERE name = 'edge'").await, 2);
    assert_eq!(test_store.count(ITERATIONS_IN_STATISTICS).await, 7);
}

#[tokio::test]
async fn iterations_repeated_in_another_stream_are_left_out() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(20).await;
    let unknown_run = RunId::random();
    // A copy of the spool sends iterations in a second stream. Its first batch has ten stored and ten
    // new iterations of `run`, and iterations of an unknown run.
    test_store.stream = StreamId::random();
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    events.extend(iterations(&test_store, run, 11..=30));
    events.extend(iterations(&test_store, unknown_run, 1..=5));
    let half_stored = test_store.batch_numbered(1, events);
    let all_stored = test_store.batch_numbered(2, iterations(&test_store, run, 1..=10));
    let not_stored = test_store.batch_numbered(3, iterations(&test_store, run, 31..=35));
    let committed = test_store.commit(&[half_stored, all_stored, not_stored]).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 3);
    assert!(committed.quarantined.is_empty(), "{:?}", committed.quarantined);
    let (stored, _) = committed.hosts[&test_store.edge];
    // `store_run` stored the start of the run and 20 iterations. The three batches added the repeated start and 10 + 5
    // iterations, no event, and 5 iterations.
    let (events, nodes, missing, quarantined) = (1 + 20 + 1 + 15 + 5, 40 * 21, 0, 0);
    assert_eq!(stored, StoredCounts { events, nodes, missing, quarantined, ..StoredCounts::default() });

    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 40);
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 40 * 21);
    assert_eq!(test_store.count("SELECT sum(ok + failed + lost + timeout + warm_up) FROM run").await, 40);
    assert_eq!(
        test_store.count("SELECT (SELECT count(*) FROM gap) + (SELECT count(*) FROM quarantine)").await,
        0
    );
    let mut connection = test_store.second_connection().await;
    let verdicts = "SELECT run, name, verdict, count FROM verdict_count ORDER BY run, name, verdict";
    let verdict_counts: Vec<(i64, i64, i64, i64)> =
        sqlx::query_as(verdicts).fetch_all(&mut connection).await.expect("reads");
    let incremental = read_rollups(&mut connection).await;
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    assert_same(&read_rollups(&mut connection).await, &incremental);
    let rebuilt_verdict_counts: Vec<(i64, i64, i64, i64)> =
        sqlx::query_as(verdicts).fetch_all(&mut connection).await.expect("reads");
    assert_eq!(rebuilt_verdict_counts, verdict_counts);
}

#[tokio::test]
async fn commit_without_log_is_not_acknowledged() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(3).await;
    let work = [test_store.batch(vec![generate::run_started(RunId::random(), "line", NOW)])];
    let log = test_store.path.with_extension("sqlite-wal");
    std::fs::remove_file(&log).expect("the log exists");
    for _ in 0..2 {
        let refused = test_store.writer.commit(&work, STAMP).await.expect_err("gone").to_string();
        assert!(refused.contains("sqlite-wal of the database was deleted"), "{refused}");
        // Another program that opens the database would create the log again.
        std::fs::write(&log, "").expect("writes");
    }
    assert!(test_store.writer.check_file().is_err());
    // After a restart, the writer continues with the contents of the database file.
    let TestStore { _folder, path, writer, store, stream, .. } = test_store;
    store.close().await;
    writer.close().await.1.expect("closes");
    let mut writer = open(&path).await;
    // When the writer closed, SQLite moved the deleted log, which it still had open, into the database file. The
    // refused commit is not stored.
    assert_eq!(writer.streams().marks.get(&stream).map(|mark| mark.stored), Some(1));
    assert_eq!(writer.commit(&work, STAMP).await.expect("commits").marks[&stream].stored, 2);
}

#[tokio::test]
async fn unreadable_batch_is_quarantined_unchanged() {
    let mut test_store = TestStore::new().await;
    let head = test_store.head(1, &[], 0);
    let batch =
        UnstorableBatch { head, frame: vec![0x81, 0xa5].into(), body: None, reason: "cut off".into() };
    let unreadable = Work::UnstorableBatch(Box::new(batch));
    let next_batch = test_store.batch_numbered(2, vec![generate::run_started(RunId::random(), "line", NOW)]);
    let committed = test_store.commit(&[unreadable, next_batch]).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 2);
    assert_eq!(committed.quarantined, [(head, "cut off".to_owned())]);
    assert_eq!(
        test_store.count("SELECT count(*) FROM quarantine WHERE frame = x'81a5' AND events IS NULL").await,
        1
    );
}

#[tokio::test]
async fn iterations_stored_before_start_stay_with_run() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let events = iterations(&test_store, run, 4..=6);
    let work = test_store.batch(events);
    let committed = test_store.commit(&[work]).await;
    assert_eq!(committed.runs, [(test_store.edge, run, 1)]);
    let before_start = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((before_start.summary.pipeline.as_str(), before_start.summary.counts.ok), ("unknown", 3));
    let work = test_store.batch(vec![generate::run_started(run, "line", NOW)]);
    test_store.commit(&[work]).await;
    let after_start = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(
        (after_start.summary.pipeline.as_str(), after_start.summary.counts.ok, after_start.version.as_str()),
        ("line", 3, "0.1.0")
    );
}

#[tokio::test]
async fn gap_belongs_to_run_and_missing_batches_to_host() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(3).await;
    let gap = Gap {
        pipeline: "line".parse().ok(),
        run: Some(run),
        from: generate::at(1.0),
        to: generate::at(2.0),
        count: 1_050,
        reason: "the queue was full".into(),
    };
    let work = test_store.batch(vec![Event::Gap(gap)]);
    test_store.commit(&[work]).await;
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((detail.gaps.len(), detail.gaps[0].count), (1, 1_050));

    let (host, stream) = (test_store.edge, test_store.stream);
    let (from, through, chain, process) = (3, 9, ChainHash::START, 7);
    let (events, events_through) = (Some(40), 700);
    let missing = MissingBatches { host, stream, from, through, chain, process, events, events_through };
    let next_batch = test_store.batch_numbered(10, vec![]);
    let committed = test_store.commit(&[Work::MissingBatches(missing), next_batch]).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 10);
    let (stored, _) = committed.hosts[&test_store.edge];
    assert_eq!((stored.gaps, stored.missing), (2, 1_090));
    assert_eq!(
        test_store.count("SELECT count(*) FROM gap WHERE count = 40 AND reason LIKE 'batches 3 to 9 of stream%stored in another database before this one was created%'")
            .await,
        1
    );
    let hosts = test_store.store.hosts().await.expect("answers");
    assert_eq!(hosts.iter().map(|host| host.name.as_str()).collect::<Vec<_>>(), ["cloud", "edge"]);
    assert_eq!(hosts[1].stored, stored);
}

#[tokio::test]
async fn events_missed_before_first_contact_have_own_count() {
    let mut test_store = TestStore::new().await;
    let (host, stream, chain, process) = (test_store.edge, test_store.stream, ChainHash::START, 7);
    let missing = |from, through, count| {
        let (events, events_through) = (Some(count), 700);
        Work::MissingBatches(MissingBatches {
            host,
            stream,
            from,
            through,
            chain,
            process,
            events,
            events_through,
        })
    };
    let started = generate::run_started(RunId::random(), "line", generate::at(1.0));
    let first_batch = test_store.batch_numbered(10, vec![started]);
    let introduction = hello(generate::host(host, "edge"), process);
    let committed = test_store.commit(&[introduction, missing(1, 9, 40), first_batch]).await;
    let (stored, _) = committed.hosts[&host];
    assert_eq!((stored.gaps, stored.missing, stored.in_other_database), (1, 40, 40));
    let incidents = "SELECT count(*) FROM incident WHERE kind = 'gap' AND text LIKE \
                     '40 events missing: from before this database: batches 1 to 9 of stream %'";
    assert_eq!(test_store.count(incidents).await, 1);

    // The host has now sent events to this database. Later missing events are therefore a loss.
    test_store.writer = open(&test_store.path).await;
    let committed = test_store.commit(&[missing(11, 12, 5)]).await;
    let (stored, _) = committed.hosts[&host];
    assert_eq!((stored.gaps, stored.missing, stored.in_other_database), (2, 45, 40));
    let hosts = test_store.store.hosts().await.expect("answers");
    let edge = hosts.iter().find(|row| row.id == host).map(|row| row.stored);
    assert_eq!(edge, Some(stored));
}

#[tokio::test]
async fn missing_events_of_all_gaps_are_counted() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(3).await;
    let gap = |index: u32| {
        Event::Gap(Gap {
            pipeline: "line".parse().ok(),
            run: Some(run),
            from: generate::at(f64::from(index)),
            to: generate::at(f64::from(index) + 0.5),
            // The last two gaps have an unknown size.
            count: if index < 1_498 { 10 } else { 0 },
            reason: "the queue was full".into(),
        })
    };
    let work = test_store.batch((0..1_500).map(gap).collect());
    // A new writer has not read the counters of the host before the commit.
    test_store.writer = open(&test_store.path).await;
    let committed = test_store.commit(&[work]).await;
    let gaps = test_store.store.run(1).await.expect("answers").expect("exists").gaps;
    let missing: u64 = gaps.iter().map(|gap| gap.count).sum();
    assert_eq!(
        (missing, gaps.len()),
        (14_980, 1_002),
        "1,000 single gaps, one entry for all further gaps of known size, one for all further gaps of unknown size"
    );
    let (stored, _) = committed.hosts[&test_store.edge];
    assert_eq!((stored.gaps, stored.unknown_gaps), (1_500, 2));
    let on_run_page = MissingCount::from_gaps(gaps.iter().map(|gap| gap.count));
    assert_eq!(stored.missing_everywhere(), on_run_page, "equal to the list of gaps");
    let hosts = test_store.store.hosts().await.expect("answers");
    assert!(hosts.iter().any(|host| host.stored == stored), "{hosts:?}");
    assert_eq!(gaps.iter().map(|gap| gap.gaps).sum::<u64>(), 1_500);
    let series = test_store.store.series(1, &[], 240).await.expect("answers");
    assert_eq!(series.gaps.len(), 1_000, "a series does not show entries that combine several gaps");
}

#[tokio::test]
async fn replaced_spool_leaves_one_gap() {
    let mut test_store = TestStore::new().await;
    let (old, new) = (test_store.stream, StreamId::random());
    let hello_work = |stream, previous_stream, replaced| {
        let (host, process, first, missing_previous) = (generate::host(test_store.edge, "edge"), 1, 5, None);
        let secret = None;
        Work::Hello(Box::new(Introduction {
            host,
            process,
            stream,
            previous_stream,
            first,
            replaced,
            missing_previous,
            secret,
        }))
    };
    let (first, renewed, replaced) = (
        hello_work(old, None, None),
        hello_work(new, Some(old), None),
        hello_work(StreamId::from_bytes([9; 16]), None, Some(new)),
    );
    test_store.commit(&[first, renewed]).await;
    assert_eq!(test_store.count("SELECT count(*) FROM gap").await, 0);
    // The introduction is committed twice, as after a commit whose result was lost.
    test_store.commit(std::slice::from_ref(&replaced)).await;
    let committed = test_store.commit(&[replaced]).await;
    let stored = committed.hosts[&test_store.edge].0;
    assert_eq!((stored.gaps, stored.missing_everywhere().number().as_str()), (1, "an unknown number"));
    assert_eq!(
        test_store
            .count("SELECT count(*) FROM gap WHERE count = 0 AND reason LIKE '%was deleted or replaced%'")
            .await,
        1
    );
    assert_eq!(
        test_store.count("SELECT count(*) FROM stream WHERE previous IS NOT NULL AND stored = 4").await,
        1,
        "without a stored batch, `stored` is the number before the stream's first batch"
    );
    test_store.writer = open(&test_store.path).await;
    assert!(test_store.writer.streams().marks.is_empty(), "no batch of any stream is stored");
    let hello = hello_of(test_store.edge, StreamId::from_bytes([9; 16]), None);
    let expected =
        StreamRecord { was_used: true, last_stream: Some(hello.stream), ..StreamRecord::default() };
    assert_eq!(test_store.writer.streams().stream_record(&hello, None), expected);
}

#[tokio::test]
async fn missing_batches_of_previous_stream_are_one_gap() {
    let mut test_store = TestStore::new().await;
    let (old, new) = (test_store.stream, StreamId::random());
    let work = test_store.batch(vec![generate::run_started(RunId::random(), "line", generate::at(1.0))]);
    let mark = test_store.commit(&[work]).await.marks[&old];
    test_store.writer = open(&test_store.path).await;
    let hello = hello_of(test_store.edge, new, Some(old));
    let expected =
        StreamRecord { last_stream: Some(old), previous_mark: Some(mark), ..StreamRecord::default() };
    assert_eq!(test_store.writer.streams().stream_record(&hello, None), expected);
    let (host, missing_previous) =
        (hello.host, Some(MissingPreviousBatches { stream: old, from: 2, through: 4, events: Some(17) }));
    let (process, previous_stream, first, replaced) = (1, Some(old), 5, None);
    let introduction = Introduction {
        host,
        process,
        stream: new,
        previous_stream,
        first,
        replaced,
        missing_previous,
        secret: None,
    };
    for _ in 0..2 {
        let committed = test_store.commit(&[Work::Hello(Box::new(introduction.clone()))]).await;
        assert_eq!(committed.hosts[&test_store.edge].0.gaps, 1);
    }
    let gaps = "SELECT count(*) FROM gap WHERE count = 17 AND reason LIKE 'batches 2 to 4 of stream % stored in a newer %'";
    assert_eq!(test_store.count(gaps).await, 1);
}

fn hello_of(host: HostId, stream: StreamId, previous_stream: Option<StreamId>) -> Hello {
    Hello {
        protocol: STREAM_VERSIONS.oldest(),
        host: generate::host(host, "edge"),
        stream,
        previous_stream,
        first: 5,
        oldest: 5,
        chain_before_oldest: ChainHash::START,
        events_before_oldest: 0,
        events_before_first: None,
        batch_bytes: 1,
        process: 1,
        extension: None,
    }
}

#[tokio::test]
async fn sums_of_reported_missing_events_do_not_overflow() {
    let mut test_store = TestStore::new().await;
    let at = generate::at(1.0);
    let gap = Gap { pipeline: None, run: None, from: at, to: at, count: u64::MAX, reason: "many".into() };
    let work = [0, 1].map(|_| test_store.batch(vec![Event::Gap(gap.clone()), Event::Gap(gap.clone())]));
    let committed = test_store.commit(&work).await;
    // The writer limits the number of missing events of a gap to 2^40.
    assert_eq!((committed.quarantined.len(), committed.hosts[&test_store.edge].0.missing), (0, 4 << 40));
    assert_eq!(test_store.count("SELECT sum(count) FROM gap").await, 4 << 40, "sums do not overflow");
    let next_batch = test_store.batch(vec![Event::Gap(gap)]);
    assert!(test_store.commit(&[next_batch]).await.quarantined.is_empty());
}

#[tokio::test]
async fn commit_to_locked_database_fails_without_changes() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut locking_writer = open(&test_store.path).await;
    locking_writer.lock().await;
    let events = vec![generate::run_started(run, "line", NOW)];
    let work = [test_store.batch(events)];
    let refused = test_store.writer.commit(&work, STAMP).await;
    let text = refused.expect_err("locked").to_string();
    assert!(text.contains("locked") && text.contains("end the program that locks it"), "{text}");
    assert!(text.contains(&test_store.path.display().to_string()), "{text}");
    drop(locking_writer);
    assert_eq!(test_store.commit(&work).await.marks[&test_store.stream].stored, 1);
    assert_eq!(test_store.count("SELECT count(*) FROM run").await, 1);
}

#[tokio::test]
async fn commit_to_full_disk_fails_without_changes() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut events = vec![generate::run_started(run, "line", NOW)];
    events.extend(iterations(&test_store, run, 1..=100));
    let work = [test_store.batch(events)];
    test_store.writer.limit_pages(1).await;
    let refused = test_store.writer.commit(&work, STAMP).await;
    let text = refused.expect_err("full").to_string();
    assert!(text.contains("full") && text.contains("free some space"), "{text}");
    assert!(text.contains(&test_store.path.display().to_string()), "{text}");
    assert_eq!(test_store.count("SELECT (SELECT count(*) FROM run) + (SELECT count(*) FROM name)").await, 0);
    test_store.writer.limit_pages(1_000_000).await;
    assert_eq!(test_store.commit(&work).await.nodes, 2_100);
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 2_100);
}

#[tokio::test]
async fn database_of_newer_version_is_refused() {
    let test_store = TestStore::new().await;
    let mut connection = super::database::open(&test_store.path).await.expect("opens");
    sqlx::query("INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES (9000, 'later', 1, x'00', 0)")
        .execute(&mut connection)
        .await
        .expect("inserts");
    let error = super::database::open(&test_store.path).await.expect_err("refuses");
    assert!(error.to_string().contains("newer version (its schema is 9000"), "{error}");
}
