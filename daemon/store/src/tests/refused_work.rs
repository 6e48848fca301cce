//! Work that the database refuses for a permanent reason does not prevent other work from being stored.

use peernet_logger::RunId;
use peernet_stream::{ChainHash, MissingBatches};

use super::{NOW, TestStore, Work, generate, open};

/// Makes missing batches of the test's stream.
fn missing_batches(test_store: &TestStore, from: u64, through: u64, events: u64) -> Work {
    Work::MissingBatches(MissingBatches {
        host: test_store.edge,
        stream: test_store.stream,
        from,
        through,
        chain: ChainHash::START,
        process: 7,
        events: Some(events),
        events_through: events,
    })
}

#[tokio::test]
async fn stream_continues_after_refused_gap() {
    let mut test_store = TestStore::new().await;
    let refusal = "CREATE TRIGGER refuse_gap BEFORE INSERT ON gap BEGIN SELECT RAISE(ABORT, 'refused'); END";
    sqlx::raw_sql(refusal).execute(&mut test_store.second_connection().await).await.expect("creates");
    let missing = missing_batches(&test_store, 1, 9, 40);
    let committed = test_store.commit(&[missing]).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 9);
    let started = generate::run_started(RunId::random(), "line", NOW);
    let work = [missing_batches(&test_store, 10, 12, 40), test_store.batch_numbered(13, vec![started])];
    let committed = test_store.commit(&work).await;
    assert_eq!(committed.marks[&test_store.stream].stored, 13);
    assert_eq!(test_store.count("SELECT count(*) FROM run").await, 1);
}

#[tokio::test]
async fn sum_of_missing_events_does_not_overflow() {
    let mut test_store = TestStore::new().await;
    for (from, through) in [(1, 9), (10, 12)] {
        // The agent states the number of events, and it may state any number.
        let missing = missing_batches(&test_store, from, through, u64::MAX);
        test_store.commit(&[missing]).await;
    }
    // A new writer reads the sum of the host's gaps.
    test_store.writer = open(&test_store.path).await;
    let next_batch = test_store.batch_numbered(13, vec![]);
    let committed = test_store.commit(&[next_batch]).await;
    let stored = committed.hosts[&test_store.edge].0;
    assert_eq!((stored.gaps, stored.missing, stored.in_other_database), (2, 2 << 40, 2 << 40));
}
