//! Time limit of queries, read-only access, and the size limit of the write-ahead log.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{ClockIdentity, SystemClock};

use super::TestStore;
use crate::Store;
use crate::error::StoreError;
use crate::integrity::Integrity;
use crate::readers::Readers;

/// A query without an end.
const ENDLESS: &str = "WITH RECURSIVE endless (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM endless) SELECT count(*) FROM endless";

/// Opens readers whose queries are stopped after 100 ms.
fn open_readers_with_short_limit(path: &Path) -> Readers {
    open_readers(path, Duration::from_millis(100))
}

fn open_readers(path: &Path, limit: Duration) -> Readers {
    let identity = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
    Readers::open(path, 1, limit, Arc::new(SystemClock::new(identity)), Integrity::new(path))
}

#[tokio::test]
async fn endless_query_is_stopped_while_writer_commits() {
    let mut test_store = TestStore::new().await;
    let readers = open_readers_with_short_limit(&test_store.path);
    let pool = readers.pool();
    let endless = sqlx::query_scalar::<_, i64>(ENDLESS).fetch_one(&pool);
    // The writer finishes while the query runs. The query would never end.
    let (endless, _) = tokio::join!(endless, test_store.store_run(50));
    let error = endless.map_err(readers.error_for("everything")).expect_err("it has no end");
    assert!(matches!(error, StoreError::TooLong { what: "everything", .. }), "{error}");
    assert!(error.to_string().contains("longer than the 0.1 s of [aggregator] question_limit_ms"), "{error}");
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 50);

    // The readers' only connection is still usable, and each query has the whole time limit.
    for _ in 0..3 {
        let iterations: i64 = sqlx::query_scalar("SELECT count(*) FROM iteration")
            .fetch_one(&readers.pool())
            .await
            .expect("answers");
        assert_eq!(iterations, 50);
        sqlx::query_scalar::<_, i64>(ENDLESS).fetch_one(&readers.pool()).await.expect_err("it has no end");
    }
}

#[tokio::test]
async fn closing_stops_queries_in_progress() {
    let test_store = TestStore::new().await;
    // The longest limit that can be configured.
    let store = Store::new(open_readers(&test_store.path, Duration::from_secs(600)));
    let mut connection = store.readers.pool().acquire().await.expect("a connection");
    let endless =
        tokio::spawn(async move { sqlx::query_scalar::<_, i64>(ENDLESS).fetch_one(&mut *connection).await });
    tokio::time::timeout(Duration::from_secs(60), store.close()).await.expect("does not wait for the query");
    let error = endless.await.expect("ends").map_err(store.readers.error_for("everything"));
    assert!(matches!(error, Err(StoreError::Closed { what: "everything" })), "{error:?}");

    store.reopen();
    let hosts =
        sqlx::query_scalar::<_, i64>("SELECT count(*) FROM host").fetch_one(&store.readers.pool()).await;
    hosts.expect("answers");
}

#[tokio::test]
async fn readers_cannot_write() {
    let test_store = TestStore::new().await;
    let refused = sqlx::query("DELETE FROM host")
        .execute(&open_readers_with_short_limit(&test_store.path).pool())
        .await;
    assert!(refused.is_err_and(|error| error.to_string().contains("readonly")));
}

#[tokio::test]
async fn log_is_emptied_only_without_readers() {
    let mut test_store = TestStore::new().await;
    let log = test_store.path.with_extension("sqlite-wal");
    let bytes = || std::fs::metadata(&log).expect("the log exists").len();
    let mut reader = test_store.second_connection().await;
    sqlx::raw_sql("BEGIN; SELECT count(*) FROM host").execute(&mut reader).await.expect("reads");
    test_store.store_run(200).await;
    let grown_bytes = bytes();
    // While a reader is active, the write-ahead log keeps its size, and the writer does not wait for the reader.
    test_store.writer.limit_write_ahead_log(grown_bytes / 2).await.expect("tries");
    assert_eq!(bytes(), grown_bytes);
    sqlx::raw_sql("COMMIT").execute(&mut reader).await.expect("ends");
    test_store.writer.limit_write_ahead_log(grown_bytes).await.expect("is short enough");
    assert_eq!(bytes(), grown_bytes);
    test_store.writer.limit_write_ahead_log(grown_bytes / 2).await.expect("empties it");
    assert_eq!(bytes(), 0);
    test_store.store_run(10).await;
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 210);
}
