//! Tests in which the database's file is moved or replaced while the aggregator runs.

use std::path::{Path, PathBuf};

use peernet_aggregator::Readiness;
use peernet_logger::{HostId, RunId};
use peernet_store::StoreError;
use peernet_stream::Event;
use sqlx::{AssertSqlSafe, Connection};

use crate::agent::Agent;
use crate::generate;
use crate::testbed::Testbed;

/// Returns the path of the database with `suffix` appended.
fn path_with_suffix(database: &Path, suffix: &str) -> PathBuf {
    let mut path = database.as_os_str().to_owned();
    path.push(suffix);
    path.into()
}

/// Moves the database away with its -wal and -shm files.
fn move_away(database: &Path) {
    for suffix in ["", "-wal", "-shm"] {
        let from = path_with_suffix(database, suffix);
        if from.exists() {
            std::fs::rename(&from, path_with_suffix(database, &format!("-away{suffix}"))).expect("moves");
        }
    }
}

/// Copies the database.
async fn backup(testbed: &Testbed) -> PathBuf {
    let copy = path_with_suffix(&testbed.database, "-copy");
    let sql = format!("VACUUM INTO '{}'", copy.display());
    sqlx::raw_sql(AssertSqlSafe(sql)).execute(&mut testbed.connection().await).await.expect("copies");
    copy
}

/// Waits until storing fails for a reason that contains `expected_text`.
async fn wait_until_not_storing(testbed: &Testbed, expected_text: &str) {
    let mut ready = testbed.aggregator().readiness();
    let is_not_storing =
        |ready: &Readiness| matches!(ready, Readiness::NotStoring(reason) if reason.contains(expected_text));
    ready.wait_for(is_not_storing).await.expect("runs");
}

/// Waits until events are stored again.
async fn wait_until_ready(testbed: &Testbed) {
    let mut ready = testbed.aggregator().readiness();
    ready.wait_for(|ready| *ready == Readiness::Ready).await.expect("runs");
}

/// An agent with one run of one pipeline.
struct TestPipeline {
    agent: Agent,
    run: RunId,
    next_number: u64,
    numbers: generate::Numbers,
}

impl TestPipeline {
    async fn new(testbed: &Testbed) -> Self {
        let (mut agent, run) = (testbed.agent("edge").await, RunId::random());
        agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
        Self { agent, run, next_number: 1, numbers: generate::Numbers::new(3) }
    }

    fn offer(&mut self, count: u64) {
        let (run, hosts) = (self.run, (self.agent.id, HostId::from_bytes([7; 16])));
        let range = self.next_number..self.next_number + count;
        self.next_number = range.end;
        self.agent
            .offer(range.map(|n| Event::Iteration(generate::iteration(run, n, hosts, &mut self.numbers))));
    }

    /// Adds iterations and waits until they are stored.
    async fn store(&mut self, count: u64) {
        self.offer(count);
        self.agent.until_stored().await;
    }
}

#[tokio::test]
async fn restored_older_copy_gets_gap_for_missing_events() {
    let mut testbed = Testbed::new().await;
    let mut pipeline = TestPipeline::new(&testbed).await;
    pipeline.store(10).await;
    let copy = backup(&testbed).await;
    pipeline.store(40).await;
    let before = testbed.aggregator().store().run(1).await.expect("answers").expect("exists");
    assert_eq!(before.summary.counts.ok, 50);
    move_away(&testbed.database);
    wait_until_not_storing(&testbed, "put it back").await;
    std::fs::rename(&copy, &testbed.database).expect("restores");
    wait_until_ready(&testbed).await;
    pipeline.store(5).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 15);
    assert_eq!(testbed.count("SELECT count(*) FROM gap").await, 1);
    let snapshot = testbed.snapshot("the counts of the restored copy", |snapshot| {
        snapshot.hosts.first().is_some_and(|host| host.stored.events < 50)
    });
    assert_eq!(snapshot.await.hosts.len(), 1);
    // Readers, too, use the file that is now at the path.
    let after = testbed.aggregator().store().run(1).await.expect("answers").expect("exists");
    assert_eq!(after.summary.counts.ok, 15);
    testbed.stop().await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 15);
}

#[tokio::test]
async fn missing_database_is_never_created_again() {
    let mut testbed = Testbed::new().await;
    let mut pipeline = TestPipeline::new(&testbed).await;
    pipeline.store(10).await;
    move_away(&testbed.database);
    wait_until_not_storing(&testbed, "its file system is not mounted").await;
    pipeline.offer(10);
    assert!(!testbed.database.exists());
    let refused = testbed.aggregator().store().run(1).await.expect_err("closed");
    assert!(matches!(refused, StoreError::Closed { .. }), "{refused}");
    assert!(testbed.aggregator().pin(1, true).await.is_err());
    std::fs::write(&testbed.database, "").expect("writes");
    wait_until_not_storing(&testbed, "is empty").await;
    std::fs::write(&testbed.database, "no database at all").expect("writes");
    wait_until_not_storing(&testbed, "not a database").await;
    assert_eq!(std::fs::read(&testbed.database).expect("reads"), b"no database at all");
    // The aggregator has checkpointed its -wal file into the moved file, which is therefore complete.
    std::fs::rename(path_with_suffix(&testbed.database, "-away"), &testbed.database).expect("moves back");
    pipeline.agent.until_stored().await;
    assert_eq!(testbed.aggregator().current_readiness(), Readiness::Ready);
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 20);
    assert_eq!(testbed.count("SELECT count(*) FROM gap").await, 0);
    testbed.stop().await;
}

#[tokio::test]
async fn log_of_replaced_database_is_not_applied() {
    let mut testbed = Testbed::new().await;
    let mut pipeline = TestPipeline::new(&testbed).await;
    pipeline.store(10).await;
    let copy = backup(&testbed).await;
    // An open read transaction prevents the checkpoint of the log.
    let mut reader = testbed.connection().await;
    sqlx::raw_sql("BEGIN; SELECT count(*) FROM iteration").execute(&mut reader).await.expect("reads");
    pipeline.store(40).await;
    std::fs::rename(&copy, &testbed.database).expect("replaces");
    wait_until_not_storing(&testbed, "belongs to another database, which was at this path before").await;
    reader.close().await.expect("closes");
    std::fs::remove_file(path_with_suffix(&testbed.database, "-wal")).expect("removes");
    wait_until_ready(&testbed).await;
    pipeline.store(5).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 15);
    testbed.stop().await;
}

#[tokio::test]
async fn removed_log_is_recreated_without_loss() {
    let mut testbed = Testbed::new().await;
    let mut pipeline = TestPipeline::new(&testbed).await;
    pipeline.store(10).await;
    std::fs::remove_file(path_with_suffix(&testbed.database, "-wal")).expect("removes");
    wait_until_not_storing(&testbed, "sqlite-wal").await;
    wait_until_ready(&testbed).await;
    pipeline.store(10).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 20);
    assert_eq!(testbed.count("SELECT count(*) FROM gap").await, 0);
    testbed.stop().await;
}

#[tokio::test]
async fn goodbye_during_outage_ends_runs() {
    let mut testbed = Testbed::new().await;
    let mut pipeline = TestPipeline::new(&testbed).await;
    pipeline.store(10).await;
    move_away(&testbed.database);
    wait_until_not_storing(&testbed, "put it back").await;
    pipeline.agent.goodbye().await;
    testbed
        .snapshot("the disconnected host", |snapshot| {
            snapshot.hosts.first().is_some_and(|host| !host.connected)
        })
        .await;
    std::fs::rename(path_with_suffix(&testbed.database, "-away"), &testbed.database).expect("moves back");
    wait_until_ready(&testbed).await;
    testbed.stop().await;
    assert_eq!(testbed.count("SELECT count(*) FROM run WHERE ended_ns IS NOT NULL").await, 1);
}
