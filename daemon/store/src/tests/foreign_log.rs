//! Write-ahead logs beside a database: the database's own log is applied, the log of another database is refused.

use std::fs;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use super::{NOW, STAMP, TestStore, open};
use crate::RetentionConfig;
use crate::error::OpenError;
use crate::foreign_log::ID_OFFSET;
use crate::incidents::PendingIncidents;
use crate::integrity::Integrity;
use crate::maintenance::{
    Backup, BackupError, ClearSecretError, DoctorError, Examination, RebuildError, RepairError,
    clear_host_secret, examine, rebuild_rollups, repair,
};
use crate::opening::OpenDatabase;

async fn connect(path: &Path) -> SqliteConnection {
    SqliteConnectOptions::new().filename(path).connect().await.expect("opens")
}

async fn number(path: &Path, sql: &'static str) -> i64 {
    let mut connection = connect(path).await;
    let number = sqlx::query_scalar(sql).fetch_one(&mut connection).await.expect("answers");
    connection.close().await.expect("closes");
    number
}

async fn iterations(path: &Path) -> i64 {
    number(path, "SELECT count(*) FROM iteration").await
}

/// Returns the id in the database file. The write-ahead log may hold another id.
fn file_id(path: &Path) -> [u8; 4] {
    fs::read(path).expect("reads")[ID_OFFSET..ID_OFFSET + 4].try_into().expect("four bytes")
}

fn log_of(path: &Path) -> PathBuf {
    PathBuf::from(format!("{}-wal", path.display()))
}

/// Copies the database and its log in the state in which a killed process leaves the two files.
fn copy_as_killed(test_store: &TestStore) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("peernet.sqlite");
    fs::copy(&test_store.path, &path).expect("copies");
    fs::copy(log_of(&test_store.path), log_of(&path)).expect("copies");
    (folder, path)
}

async fn checkpoint(test_store: &TestStore) {
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")
        .execute(&mut test_store.second_connection().await)
        .await
        .expect("moves the log into the file");
}

async fn backup(test_store: &TestStore, name: &str) -> PathBuf {
    let target = test_store.path.with_file_name(name);
    let backup = Backup::prepare(&test_store.path, &target).await.expect("can be read");
    backup.run(CancellationToken::new()).await.expect("copies").path
}

async fn start(path: &Path) -> Result<(), OpenError> {
    let integrity = Integrity::new(path);
    let (database, _) = OpenDatabase::open(path, RetentionConfig::default(), &integrity).await?;
    database.close().await.1.expect("closes");
    Ok(())
}

#[tokio::test]
async fn backup_is_not_spoilt_by_log_of_previous_database() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    checkpoint(&test_store).await;
    let copy = backup(&test_store, "copy.sqlite").await;
    test_store.store_run(100).await;
    let (_folder, path) = copy_as_killed(&test_store);
    // The backup replaces the database file, and the log of the replaced file stays.
    fs::copy(&copy, path.with_file_name("copy.sqlite")).expect("copies");
    fs::rename(path.with_file_name("copy.sqlite"), &path).expect("takes its place");
    let files = || (fs::read(&path).expect("is there"), fs::read(log_of(&path)).expect("is there"));
    let files_before = files();

    let refused = start(&path).await.expect_err("refuses");
    assert!(matches!(refused, OpenError::ForeignLog(_)), "{refused}");
    let message = refused.to_string();
    assert!(
        message.contains("peernet.sqlite-wal belongs to another database, which was at this path before"),
        "{message}"
    );
    assert!(message.contains("delete the log"), "{message}");
    let examined = examine(&path, Examination { full: false, now: NOW }).await;
    assert!(matches!(examined, Err(DoctorError::ForeignLog(_))), "{examined:?}");
    let repaired = repair(&path, NOW, "now", |_| {}).await;
    assert!(matches!(repaired, Err(RepairError::ForeignLog(_))), "{repaired:?}");
    let rebuilt = rebuild_rollups(&path, None, |_| {}).await;
    assert!(matches!(rebuilt, Err(RebuildError::Open(OpenError::ForeignLog(_)))), "{rebuilt:?}");
    let cleared = clear_host_secret(&path, "edge").await;
    assert!(matches!(cleared, Err(ClearSecretError::ForeignLog(_))), "{cleared:?}");
    let second_backup = Backup::prepare(&path, &path.with_file_name("again.sqlite")).await;
    assert!(matches!(second_backup, Err(BackupError::ForeignLog(_))), "{second_backup:?}");
    assert!(files() == files_before, "nothing was written");

    fs::remove_file(log_of(&path)).expect("removes");
    start(&path).await.expect("opens");
    assert_eq!(iterations(&path).await, 100);
    let report = examine(&path, Examination { full: true, now: NOW }).await.expect("opens");
    assert!(report.is_healthy(), "{report:?}");
}

#[tokio::test]
async fn log_of_idle_aggregator_identifies_its_database() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(10).await;
    let copy = backup(&test_store, "copy.sqlite").await;
    test_store.writer.close().await.1.expect("closes");
    test_store.store.close().await;
    test_store.writer = open(&test_store.path).await;
    // Without events, an aggregator stores only the readings of its clocks.
    test_store.writer.store_clock_readings(STAMP, &mut PendingIncidents::new(STAMP)).await.expect("stores");
    let (_folder, path) = copy_as_killed(&test_store);
    fs::copy(&copy, &path).expect("takes its place");
    assert!(matches!(start(&path).await, Err(OpenError::ForeignLog(_))));

    // SQLite does not apply a log with wrong checksums. Such a log does no harm, so the database
    // opens. The overwritten bytes lie in the log's first page.
    let log = fs::File::options().write(true).open(log_of(&path)).expect("opens");
    log.write_all_at(&[0xa5; 4], 100).expect("writes");
    start(&path).await.expect("opens");
    assert_eq!(iterations(&path).await, 10);
}

#[tokio::test]
async fn database_of_killed_process_opens_with_its_log() {
    let mut test_store = TestStore::new().await;
    // The file itself has no id yet.
    test_store.store_run(100).await;
    let (_first, path) = copy_as_killed(&test_store);
    assert_eq!(file_id(&path), [0; 4]);
    start(&path).await.expect("opens");
    assert_eq!(iterations(&path).await, 100);

    checkpoint(&test_store).await;
    test_store.store_run(50).await;
    let (_second, path) = copy_as_killed(&test_store);
    assert_ne!(file_id(&path), [0; 4]);
    start(&path).await.expect("opens");
    assert_eq!(iterations(&path).await, 150);

    // The file of an earlier version has no id. The id that the writer adds is at first only in the log.
    test_store.writer.close().await.1.expect("closes");
    test_store.store.close().await;
    fs::File::options()
        .write(true)
        .open(&test_store.path)
        .expect("opens")
        .write_all_at(&[0; 4], ID_OFFSET as u64)
        .expect("writes");
    test_store.writer = open(&test_store.path).await;
    let (_third, path) = copy_as_killed(&test_store);
    assert_eq!(file_id(&path), [0; 4]);
    start(&path).await.expect("opens");
    assert_ne!(file_id(&path), [0; 4]);
    assert_eq!(iterations(&path).await, 150);
}

#[tokio::test]
async fn each_file_has_own_id_and_keeps_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let new_file = folder.path().join("peernet.sqlite");
    start(&new_file).await.expect("creates the file");
    let id_of_new_file = file_id(&new_file);
    assert_ne!(id_of_new_file, [0; 4]);
    start(&new_file).await.expect("opens");
    assert_eq!(file_id(&new_file), id_of_new_file);

    let mut test_store = TestStore::new().await;
    test_store.store_run(100).await;
    let (first_copy, second_copy) =
        (backup(&test_store, "one.sqlite").await, backup(&test_store, "other.sqlite").await);
    checkpoint(&test_store).await;
    let mut ids =
        vec![id_of_new_file, file_id(&test_store.path), file_id(&first_copy), file_id(&second_copy)];
    // A repair writes a new file, which has an id of its own.
    let root = number(&first_copy, "SELECT rootpage FROM sqlite_schema WHERE name = 'node'").await;
    let file = fs::File::options().write(true).open(&first_copy).expect("opens");
    file.write_all_at(&[0xa5; 4096], (root.cast_unsigned() - 1) * 4096).expect("writes");
    drop(file);
    repair(&first_copy, NOW, "now", |_| {}).await.expect("repairs").expect("was damaged");
    ids.push(file_id(&first_copy));
    assert!(!ids.contains(&[0; 4]), "{ids:?}");
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), 5);
}
