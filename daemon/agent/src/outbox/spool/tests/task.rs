//! Tests of the task and its channels.

use std::time::Duration;

use peernet_stream::{ChainHash, StreamId};

use super::super::error::SpoolFileError;
use super::super::task::{SpoolRequest, SpoolResult, SpoolTask, SpoolTaskError};
use super::*;

const HOUR: Duration = Duration::from_secs(3600);

#[tokio::test]
async fn requests_are_executed_in_order_and_answered() {
    let spool_folder = SpoolFolder::new();
    let (file, fresh) = spool_folder.open_undamaged().await;
    let mut task = SpoolTask::start(file, HOUR);
    let written_batches = batches(ChainHash::START, 1..=3, 10);
    task.request(SpoolRequest::Append { batches: written_batches.clone(), totals: totals(9) })
        .expect("the task accepts the request");
    task.request(SpoolRequest::Load { from: 2, bytes: usize::MAX }).expect("the task accepts the request");
    task.request(SpoolRequest::Delete { through: 1, chain: written_batches[0].chain })
        .expect("the task accepts the request");
    let stream = StreamId::random();
    task.request(SpoolRequest::Renew {
        stream,
        previous_stream: fresh.stream,
        first: 2,
        events_before_first: 3,
    })
    .expect("the task accepts the request");
    assert!(matches!(task.next_result().await, Some(SpoolResult::Appended(Ok(())))));
    let Some(SpoolResult::Loaded(Ok(loaded))) = task.next_result().await else { panic!("loading failed") };
    assert_eq!(loaded.batches, written_batches[1..]);
    assert!(matches!(task.next_result().await, Some(SpoolResult::Deleted(Ok(())))));
    assert!(matches!(task.next_result().await, Some(SpoolResult::Renewed(Ok(())))));
    task.close().await.expect("closes");
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.stream, state.oldest, state.newest.0), (stream, 2, 3));
}

#[tokio::test]
async fn last_request_is_executed_before_closing() {
    let spool_folder = SpoolFolder::new();
    let (file, _) = spool_folder.open_undamaged().await;
    let task = SpoolTask::start(file, HOUR);
    let written_batches = batches(ChainHash::START, 1..=3, 10);
    task.request(SpoolRequest::Append { batches: written_batches, totals: totals(9) })
        .expect("the task accepts the request");
    task.close().await.expect("closes");
    assert_eq!(spool_folder.open_undamaged().await.1.newest.0, 3);
}

#[tokio::test]
async fn append_to_moved_file_fails_with_its_path() {
    let spool_folder = SpoolFolder::new();
    let (file, _) = spool_folder.open_undamaged().await;
    let mut task = SpoolTask::start(file, HOUR);
    std::fs::rename(spool_folder.path(), spool_folder.folder.path().join("away")).expect("moved");
    task.request(SpoolRequest::Append { batches: batches(ChainHash::START, 1..=1, 10), totals: totals(3) })
        .expect("the task accepts the request");
    let Some(SpoolResult::Appended(Err(error))) = task.next_result().await else {
        panic!("the append succeeded")
    };
    assert!(matches!(error, SpoolTaskError::File(SpoolFileError::Moved(_))), "{error}");
    assert!(error.to_string().contains("spool.sqlite"), "{error}");
}

#[tokio::test]
async fn damage_found_by_append_quarantines_file_at_next_start() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    // Damage that SQLite itself detects: the tree of the table leads to a page of another table.
    sqlx::raw_sql(
        "PRAGMA writable_schema = ON;
         UPDATE sqlite_schema SET rootpage = (SELECT rootpage FROM sqlite_schema WHERE name = 'sqlite_autoindex__sqlx_migrations_1') WHERE name = 'batch';
         PRAGMA writable_schema = RESET",
    )
    .execute(file.connection())
    .await
    .expect("damages the schema");
    let mut task = SpoolTask::start(file, HOUR);
    task.request(SpoolRequest::Append { batches: batches(ChainHash::START, 1..=1, 10), totals: totals(3) })
        .expect("the task accepts the request");
    let Some(SpoolResult::Appended(Err(error))) = task.next_result().await else {
        panic!("the append succeeded")
    };
    assert!(error.to_string().contains("quarantines the file"), "{error}");
    drop(task.close().await);
    let quarantined = spool_folder.open().await.expect("opens").quarantined.expect("is quarantined");
    assert!(quarantined.reason.contains("append"), "{}", quarantined.reason);
    assert_eq!(list_files(spool_folder.folder.path()), ["spool.sqlite", "spool.sqlite.damaged-5"]);
}
