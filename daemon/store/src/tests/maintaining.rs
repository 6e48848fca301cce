//! Backups and examinations of a database that is being written.

use std::os::unix::fs::FileExt;
use std::path::Path;

use peernet_clock::Span;
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tokio_util::sync::CancellationToken;

use super::{NOW, TestStore};
use crate::maintenance::{
    Backup, BackupError, DoctorError, Examination, Report, Severity, examine, rebuild_rollups,
};

const QUICK: Examination = Examination { full: false, now: NOW };
const FULL: Examination = Examination { full: true, now: NOW };

async fn count(path: &Path, table: &str) -> i64 {
    let mut connection = SqliteConnectOptions::new().filename(path).connect().await.expect("opens");
    let statement = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
    sqlx::query_scalar(statement).fetch_one(&mut connection).await.expect("counts")
}

fn problems(report: &Report) -> Vec<&str> {
    let problem_findings = report.findings.iter().filter(|finding| finding.severity == Severity::Problem);
    problem_findings.map(|finding| finding.what.as_str()).collect()
}

#[tokio::test]
async fn backup_is_consistent_and_overwrites_no_file() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    let target = test_store.path.with_file_name("copy.sqlite");
    // A killed backup left a file behind. The next backup overwrites this file.
    std::fs::write(target.with_file_name("copy.sqlite.partial"), b"left behind").expect("writable");
    let backup = Backup::prepare(&test_store.path, &target).await.expect("can be read");
    assert!(backup.expected_bytes() > 100_000);
    let second_backup = Backup::prepare(&test_store.path, &target).await.expect_err("a backup is under way");
    assert!(matches!(second_backup, BackupError::UnderWay(_)), "{second_backup}");
    let copied = backup.run(CancellationToken::new()).await.expect("copies");
    test_store.store_run(100).await;

    assert_eq!(copied.path, target);
    assert_eq!(copied.bytes, std::fs::metadata(&target).expect("is there").len());
    assert!(!target.with_file_name("copy.sqlite.partial").exists());
    assert_eq!((count(&target, "iteration").await, count(&test_store.path, "iteration").await), (100, 200));
    let report = examine(&target, FULL).await.expect("opens");
    assert!(report.is_healthy() && report.integrity.full, "{report:?}");

    let repeated_backup = Backup::prepare(&test_store.path, &target).await.expect_err("the target exists");
    assert!(matches!(repeated_backup, BackupError::Exists(_)), "{repeated_backup}");
    // A file that another program creates under the target's name during the backup is not replaced.
    let other = test_store.path.with_file_name("other.sqlite");
    let backup = Backup::prepare(&test_store.path, &other).await.expect("can be read");
    std::fs::write(&other, b"theirs").expect("writable");
    let late_refusal = backup.run(CancellationToken::new()).await.expect_err("the target exists");
    assert!(matches!(late_refusal, BackupError::Exists(_)), "{late_refusal}");
    assert_eq!(std::fs::read(&other).expect("is there"), b"theirs");
    assert!(!other.with_file_name("other.sqlite.partial").exists());
}

#[tokio::test]
async fn stopped_backup_leaves_no_file() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    let target = test_store.path.with_file_name("copy.sqlite");
    let backup = Backup::prepare(&test_store.path, &target).await.expect("can be read");
    let stop = CancellationToken::new();
    stop.cancel();
    let stopped = backup.run(stop).await.expect_err("stopped");
    assert!(matches!(stopped, BackupError::Stopped), "{stopped}");
    assert!(!target.exists() && !target.with_file_name("copy.sqlite.partial").exists());
    let missing = Backup::prepare(&target, &test_store.path).await.expect_err("no such database");
    assert!(matches!(missing, BackupError::Missing(_)), "{missing}");
}

#[tokio::test]
async fn healthy_database_is_examined_during_writing() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    let report = examine(&test_store.path, QUICK).await.expect("opens");
    assert!(report.is_healthy(), "{report:?}");
    let rows = |table: &str| report.tables.iter().find(|rows| rows.table == table).expect("is there");
    assert_eq!((rows("run").rows, rows("run").estimated), (1, false));
    assert_eq!((rows("iteration").rows, rows("iteration").estimated), (100, true));
    assert_eq!(rows("node").rows, count(&test_store.path, "node").await.cast_unsigned());
    let stream = report.streams.iter().find(|stream| stream.stored > 0).expect("one has batches");
    // The start of the run and 100 iterations fill three batches of at most 50 events.
    assert_eq!((stream.host.as_deref(), stream.stored), (Some("edge"), 3));
    assert!(report.rollups.iter().any(|extent| extent.oldest_s.is_some()), "{report:?}");
    assert!(report.file.bytes > 0 && report.file.disk_free_bytes > 0);
}

#[tokio::test]
async fn estimated_row_counts_are_exact_after_deletions() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    let mut connection =
        SqliteConnectOptions::new().filename(&test_store.path).connect().await.expect("opens");
    sqlx::raw_sql("DELETE FROM node WHERE iteration <= 60; DELETE FROM iteration WHERE number <= 60")
        .execute(&mut connection)
        .await
        .expect("deletes");
    let report = examine(&test_store.path, QUICK).await.expect("opens");
    let iterations = count(&test_store.path, "iteration").await;
    assert!((1..100).contains(&iterations), "{iterations}");
    for table in ["iteration", "node"] {
        let reported_rows = report.tables.iter().find(|rows| rows.table == table).expect("is there").rows;
        assert_eq!(reported_rows, count(&test_store.path, table).await.cast_unsigned(), "{table}");
    }
}

#[tokio::test]
async fn full_list_of_open_runs_states_minimum() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(1).await;
    let mut connection =
        SqliteConnectOptions::new().filename(&test_store.path).connect().await.expect("opens");
    sqlx::raw_sql(
        "WITH RECURSIVE copy (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM copy WHERE n < 1500) \
         INSERT INTO run (uuid, pipeline, started_ns, placement, model, facts, configuration, version) \
         SELECT uuid || n, pipeline, started_ns, placement, model, facts, configuration, version FROM run, copy",
    )
    .execute(&mut connection)
    .await
    .expect("inserts");
    let later = Examination { now: NOW + Span::from_seconds(100_000), ..QUICK };
    let report = examine(&test_store.path, later).await.expect("opens");
    assert!(
        report.findings.iter().any(|finding| finding.what.starts_with("at least 1000 runs have no end")),
        "{report:?}"
    );
}

#[tokio::test]
async fn spool_is_distinguished_from_database() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("spool.sqlite");
    let options = SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let mut connection = options.connect().await.expect("opens");
    sqlx::raw_sql(include_str!("../../../../migrations/spool/0001_spool.sql"))
        .execute(&mut connection)
        .await
        .expect("makes its tables");
    let report = examine(&path, QUICK).await.expect("opens");
    assert!(problems(&report).iter().any(|problem| problem.contains("an agent's spool")), "{report:?}");
    assert!(report.findings.iter().any(|finding| finding.advice.contains("--spool")), "{report:?}");
    let refused = Backup::prepare(&path, &folder.path().join("copy.sqlite")).await.expect_err("no database");
    assert!(refused.to_string().contains("an agent's spool"), "{refused}");
    let refused = rebuild_rollups(&path, None, |_| {}).await.expect_err("no database");
    assert!(refused.to_string().contains("an agent's spool"), "{refused}");
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_schema WHERE type = 'table'")
        .fetch_one(&mut connection)
        .await
        .expect("reads");
    assert_eq!(tables, 3, "no table was added");
}

#[tokio::test]
async fn damaged_page_is_reported() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(200).await;
    let copy = test_store.path.with_file_name("copy.sqlite");
    let backup = Backup::prepare(&test_store.path, &copy).await.expect("can be read");
    backup.run(CancellationToken::new()).await.expect("copies");
    let file = std::fs::File::options().read(true).write(true).open(&copy).expect("opens");
    let mut connection = SqliteConnectOptions::new().filename(&copy).connect().await.expect("opens");
    let page: i64 = sqlx::query_scalar("SELECT rootpage FROM sqlite_schema WHERE name = 'node'")
        .fetch_one(&mut connection)
        .await
        .expect("is there");
    drop(connection);
    // Overwrites the head of the table's first page, which holds the page's type and number of cells.
    file.write_all_at(&[0xa5; 16], (page.cast_unsigned() - 1) * 4096).expect("writes");
    let report = examine(&copy, QUICK).await.expect("opens");
    assert!(problems(&report).iter().any(|problem| problem.contains("damaged")), "{report:?}");
    assert!(report.findings.iter().all(|finding| !finding.advice.is_empty()));
    let report = examine(&copy, FULL).await.expect("opens");
    assert!(!report.integrity.full, "after damage the full check is skipped");

    // A file that is no database is reported, too, and so is the database of another program.
    file.write_all_at(&[0xa5; 100], 0).expect("writes");
    let report = examine(&copy, QUICK).await.expect("opens");
    assert!(problems(&report).iter().any(|problem| problem.contains("not a database")), "{report:?}");
    let other = test_store.path.with_file_name("other.sqlite");
    let options = SqliteConnectOptions::new().filename(&other).create_if_missing(true);
    let mut connection = options.connect().await.expect("opens");
    sqlx::query("CREATE TABLE other (id)").execute(&mut connection).await.expect("makes a table");
    let report = examine(&other, QUICK).await.expect("opens");
    assert!(problems(&report).iter().any(|problem| problem.contains("not an aggregator's")), "{report:?}");
    let missing =
        examine(&test_store.path.with_file_name("none.sqlite"), QUICK).await.expect_err("is not there");
    assert!(matches!(missing, DoctorError::Missing(_)), "{missing}");
}
