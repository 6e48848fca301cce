//! Tests of full disks and of files that are moved.

use std::fs;
use std::os::unix::fs::MetadataExt;

use peernet_stream::ChainHash;

use super::*;

/// Limits the growth of the file to a number of pages.
async fn limit_growth(file: &mut SpoolFile, pages: i64) {
    let current: i64 =
        sqlx::query_scalar("PRAGMA page_count").fetch_one(file.connection()).await.expect("counts");
    let limit = format!("PRAGMA max_page_count = {}", current + pages);
    sqlx::query(sqlx::AssertSqlSafe(limit)).execute(file.connection()).await.expect("limited");
}

#[tokio::test]
async fn append_to_full_disk_writes_no_batch() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=40, 10_000);
    file.append(&written_batches[..2], &totals(6)).await.expect("appends");
    limit_growth(&mut file, 10).await;
    let error = file
        .append(&written_batches[2..], &totals(120))
        .await
        .expect_err("the batches do not fit")
        .to_string();
    assert!(error.contains("the disk is full") && error.contains("spool.sqlite"), "{error}");
    assert_eq!(
        file.load(1, usize::MAX).await.expect("loads").batches,
        written_batches[..2],
        "no batch of the refused append"
    );

    file.append(&written_batches[2..4], &totals(12)).await.expect("two batches fit");
    file.append(&written_batches[4..7], &totals(21)).await.expect_err("three more batches do not fit");
    file.delete_through(2, written_batches[1].chain).await.expect("deletes");
    file.append(&written_batches[4..6], &totals(18)).await.expect("two batches fit after the deletion");
    assert_eq!(file.load(3, usize::MAX).await.expect("loads").batches, written_batches[2..6]);
    drop(file.close().await);
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.oldest, state.newest.0, state.totals), (3, 6, totals(18)));
}

#[tokio::test]
async fn reserve_for_deleting_survives_restart() {
    let spool_folder = SpoolFolder::new();
    let reserve_file = || {
        let metadata = fs::metadata(spool_folder.folder.path().join("spool.sqlite-reserve"));
        // `None` on a file system that cannot allocate space.
        metadata.ok().map(|metadata| (metadata.ino(), metadata.blocks()))
    };
    let (file, _) = spool_folder.open_undamaged().await;
    let reserved = reserve_file();
    drop(file);
    assert_eq!(reserve_file(), reserved);
    let (file, _) = spool_folder.open_undamaged().await;
    assert_eq!(
        reserve_file(),
        reserved,
        "the space is never released, because another program could take it"
    );
    file.close().await.expect("closes");
    assert_eq!(reserve_file(), reserved);
}

#[tokio::test]
async fn moved_file_is_not_written_until_moved_back() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=2, 10);
    file.append(&written_batches[..1], &totals(3)).await.expect("appends");
    let new_path = spool_folder.folder.path().join("away");
    fs::rename(spool_folder.path(), &new_path).expect("moved");
    let error = file.append(&written_batches[1..], &totals(6)).await.expect_err("moved").to_string();
    assert!(error.contains("deleted, moved or replaced"), "{error}");
    file.delete_through(1, written_batches[0].chain).await.expect_err("moved");
    fs::write(spool_folder.path(), b"something else").expect("written");
    file.append(&written_batches[1..], &totals(6)).await.expect_err("replaced");
    fs::rename(&new_path, spool_folder.path()).expect("moved back");
    file.append(&written_batches[1..], &totals(6)).await.expect("appends");
    assert_eq!(file.load(1, usize::MAX).await.expect("loads").batches, written_batches);
}

#[tokio::test]
async fn error_says_that_folder_cannot_be_created() {
    let spool_folder = SpoolFolder::new();
    fs::write(spool_folder.folder.path().join("file"), b"").expect("written");
    let path = spool_folder.folder.path().join("file").join("spool.sqlite");
    let is_default_path = true;
    let error =
        OpenSpool::open(&path, host(), is_default_path, &clock()).await.expect_err("no folder").to_string();
    assert!(error.contains("cannot create") && error.contains("[spool] file"), "{error}");
}
