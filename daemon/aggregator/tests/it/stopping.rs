//! Tests of the stop of an aggregator: the state of the files afterwards.

use peernet_logger::{HostId, RunId};
use peernet_store::RunFilter;
use peernet_stream::Event;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, SqliteConnection};

use crate::generate;
use crate::testbed::Testbed;

async fn query_text(connection: &mut SqliteConnection, sql: &'static str) -> String {
    sqlx::query_scalar(sql).fetch_one(connection).await.expect("answers")
}

#[tokio::test]
async fn database_file_is_complete_after_clean_stop() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    let (run, hosts) = (RunId::random(), (agent.id, HostId::from_bytes([7; 16])));
    let mut numbers = generate::Numbers::new(3);
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    agent.offer((1..=300).map(|n| Event::Iteration(generate::iteration(run, n, hosts, &mut numbers))));
    agent.until_stored().await;
    // Readers have connections, too. This handle keeps these connections open.
    let handle = testbed.aggregator().clone();
    let store = handle.store();
    let (filter, stages) = (RunFilter::default(), ["total".into()]);
    let (listed, _, _) =
        tokio::join!(store.runs(&filter), store.statistics_of(1), store.series(1, &stages, 100));
    assert_eq!(listed.expect("answers").len(), 1);
    let log = testbed.database.with_file_name("peernet.sqlite-wal");
    assert!(
        std::fs::metadata(&log).is_ok_and(|log| log.len() > 0),
        "the log is written while the aggregator runs"
    );
    testbed.stop().await;

    assert!(!log.exists(), "{} bytes are left", std::fs::metadata(&log).map_or(0, |log| log.len()));
    let elsewhere = tempfile::tempdir().expect("a folder");
    let copy = elsewhere.path().join("copy.sqlite");
    std::fs::copy(&testbed.database, &copy).expect("copies");
    let mut copied = SqliteConnectOptions::new().filename(&copy).connect().await.expect("opens");
    assert_eq!(query_text(&mut copied, "PRAGMA quick_check").await, "ok");
    assert_eq!(
        query_text(&mut copied, "SELECT count(*) || ' ' || max(number) FROM iteration").await,
        "300 300"
    );
    drop(handle);
}
