//! Files that are broken, and rows that are.

use std::fs;
use std::io::{Seek, SeekFrom, Write};

use peernet_logger::stream::Chain;

use super::*;

#[tokio::test]
async fn a_file_that_is_no_database_is_put_aside_and_a_new_one_begins() {
    let place = Place::new();
    fs::write(place.path(), b"this is no database at all, and long enough to be seen as none".repeat(100))
        .expect("written");
    let OpenSpool { mut file, state, aside } = place.open().await.expect("opens");
    let aside = aside.expect("put aside");
    assert_eq!(aside.kept, place.folder.path().join("spool.sqlite.damaged-5"));
    assert!(aside.reason.contains("spool.sqlite"), "{}", aside.reason);
    assert!(fs::read(&aside.kept).expect("kept").starts_with(b"this is no database"));
    file.append(&batches(Chain::START, 1..=2, 10), totals(6)).await.expect("appends");
    drop(file.close().await);

    let (file, again) = place.sound().await;
    assert_eq!((again.stream, again.newest.0), (state.stream, 2));
    drop(file.close().await);
    fs::write(place.path(), b"once more").expect("written");
    let second = place.open().await.expect("opens").aside.expect("put aside");
    assert_eq!(second.kept, place.folder.path().join("spool.sqlite.damaged-6"), "none is overwritten");
}

#[tokio::test]
async fn a_file_whose_tables_are_broken_is_put_aside() {
    let place = Place::new();
    let (mut file, _) = place.sound().await;
    file.append(&batches(Chain::START, 1..=20, 1000), totals(60)).await.expect("appends");
    drop(file.close().await);
    // All pages but the first, which says what kind of file it is.
    let length = fs::metadata(place.path()).expect("there").len();
    let mut broken = fs::File::options().write(true).open(place.path()).expect("opens");
    broken.seek(SeekFrom::Start(4096)).expect("seeks");
    broken.write_all(&vec![0xa5; (length - 4096) as usize]).expect("written");
    drop(broken);

    let OpenSpool { state, aside, .. } = place.open().await.expect("opens");
    assert!(aside.is_some());
    assert_eq!(state.newest, (0, Chain::START));
    assert_eq!(names(place.folder.path()), ["spool.sqlite", "spool.sqlite.damaged-5"]);
}

#[tokio::test]
async fn a_rotten_batch_ends_the_list_and_is_named() {
    let place = Place::new();
    let (mut file, _) = place.sound().await;
    let written = batches(Chain::START, 1..=5, 100);
    file.append(&written, totals(15)).await.expect("appends");
    sqlx::query("UPDATE batch SET body = zeroblob(100) WHERE number = 3")
        .execute(file.connection())
        .await
        .expect("changed");
    let loaded = file.load(1, usize::MAX).await.expect("loads");
    assert_eq!(loaded.batches, written[..2]);
    let said = loaded.rotten.expect("said");
    assert!(said.contains("batch 3") && said.contains("not what was written"), "{said}");
    let loaded = file.load(3, usize::MAX).await.expect("loads");
    assert!(loaded.batches.is_empty() && loaded.rotten.is_some());
    assert_eq!(file.load(4, usize::MAX).await.expect("loads").batches, written[3..], "what follows is sound");
}

#[tokio::test]
async fn a_missing_batch_ends_the_list() {
    let place = Place::new();
    let (mut file, _) = place.sound().await;
    let written = batches(Chain::START, 1..=5, 100);
    file.append(&written, totals(15)).await.expect("appends");
    sqlx::query("DELETE FROM batch WHERE number = 3").execute(file.connection()).await.expect("changed");
    assert_eq!(file.load(1, usize::MAX).await.expect("loads").batches, written[..2]);
    let loaded = file.load(3, usize::MAX).await.expect("loads");
    assert!(loaded.batches.is_empty());
    assert!(loaded.rotten.expect("said").contains("batch 3"), "named");
    assert_eq!(file.load(4, usize::MAX).await.expect("loads").batches, written[3..], "what is behind it");
    drop(file.close().await);
    let (_, state) = place.sound().await;
    assert_eq!((state.oldest, state.newest.0, state.held.events), (1, 5, 12));
}

#[tokio::test]
async fn a_spool_of_a_newer_version_is_refused_and_left_alone() {
    let place = Place::new();
    let (mut file, _) = place.sound().await;
    sqlx::query(
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
         VALUES (9, 'future', TRUE, x'00', 0)",
    )
    .execute(file.connection())
    .await
    .expect("changed");
    drop(file.close().await);
    let refused = place.open().await.expect_err("too new").to_string();
    assert!(refused.contains("newer version") && refused.contains('9'), "{refused}");
    assert_eq!(names(place.folder.path()), ["spool.sqlite"]);
}
