//! Tests of damaged files and rows.

use std::fs;
use std::io::{Seek, SeekFrom, Write};

use peernet_stream::ChainHash;
use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};

use super::*;
use crate::outbox::spool::quarantine::{flag_as_damaged, quarantine_reason, with_suffix};

#[tokio::test]
async fn invalid_database_is_quarantined_and_replaced() {
    let spool_folder = SpoolFolder::new();
    fs::write(
        spool_folder.path(),
        b"this is no database at all, and long enough to be seen as none".repeat(100),
    )
    .expect("written");
    let OpenSpool { mut file, state, quarantined, .. } = spool_folder.open().await.expect("opens");
    let quarantined = quarantined.expect("is quarantined");
    // The number is the time of the tests' clock in seconds.
    assert_eq!(quarantined.new_path, spool_folder.folder.path().join("spool.sqlite.damaged-5"));
    assert!(quarantined.reason.contains("spool.sqlite"), "{}", quarantined.reason);
    assert!(
        fs::read(&quarantined.new_path).expect("the file still exists").starts_with(b"this is no database")
    );
    file.append(&batches(ChainHash::START, 1..=2, 10), &totals(6)).await.expect("appends");
    drop(file.close().await);

    let (file, reopened) = spool_folder.open_undamaged().await;
    assert_eq!((reopened.stream, reopened.newest.0), (state.stream, 2));
    drop(file.close().await);
    fs::write(spool_folder.path(), b"once more").expect("written");
    let second = spool_folder.open().await.expect("opens").quarantined.expect("is quarantined");
    assert_eq!(
        second.new_path,
        spool_folder.folder.path().join("spool.sqlite.damaged-6"),
        "the earlier quarantined file is not overwritten"
    );
}

#[tokio::test]
async fn file_of_another_program_is_kept() {
    let spool_folder = SpoolFolder::new();
    let notes = spool_folder.folder.path().join("notes");
    fs::write(&notes, "not for you").expect("written");
    let is_default_path = false;
    let error =
        OpenSpool::open(&notes, host(), is_default_path, &clock()).await.expect_err("no spool").to_string();
    assert!(error.contains("notes is not a spool") && error.contains("[spool] file"), "{error}");
    assert_eq!(fs::read(&notes).expect("the file exists"), b"not for you");

    // The database of another program is refused also at the default path. In the first round its only table is still
    // in its write-ahead log; in the second round the table is in the file.
    let options = SqliteConnectOptions::new().filename(spool_folder.path()).create_if_missing(true);
    let options = options.journal_mode(SqliteJournalMode::Wal);
    let mut other_database = options.connect().await.expect("opens");
    sqlx::query("CREATE TABLE theirs (id)").execute(&mut other_database).await.expect("creates a table");
    for _ in 0..2 {
        let error = spool_folder.open().await.expect_err("no spool").to_string();
        assert!(error.contains("another program"), "{error}");
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")
            .execute(&mut other_database)
            .await
            .expect("moves the log");
    }
    let tables: Vec<String> = sqlx::query_scalar("SELECT name FROM sqlite_schema")
        .fetch_all(&mut other_database)
        .await
        .expect("reads");
    assert_eq!(tables, ["theirs"]);
    assert_eq!(list_files(spool_folder.folder.path()), ["notes", "spool.sqlite"]);
}

#[tokio::test]
async fn spool_whose_tables_are_only_in_write_ahead_log_is_recognised() {
    let spool_folder = SpoolFolder::new();
    let (file, state) = spool_folder.open_undamaged().await;
    // A copy without a checkpoint is what a killed process leaves.
    let killed = SpoolFolder::new();
    for ending in ["", "-wal"] {
        fs::copy(with_suffix(&spool_folder.path(), ending), with_suffix(&killed.path(), ending))
            .expect("copied");
    }
    drop(file);
    let (_, reopened) = killed.open_undamaged().await;
    assert_eq!(reopened, state);
}

#[tokio::test]
async fn file_with_broken_tables_is_quarantined() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    file.append(&batches(ChainHash::START, 1..=20, 1000), &totals(60)).await.expect("appends");
    drop(file.close().await);
    // All pages except the first page, which has the header, are overwritten.
    let length = fs::metadata(spool_folder.path()).expect("the file exists").len();
    let mut damaged_file = fs::File::options().write(true).open(spool_folder.path()).expect("opens");
    damaged_file.seek(SeekFrom::Start(4096)).expect("seeks");
    damaged_file.write_all(&vec![0xa5; (length - 4096) as usize]).expect("written");
    drop(damaged_file);

    let OpenSpool { state, quarantined, .. } = spool_folder.open().await.expect("opens");
    assert!(quarantined.is_some());
    assert_eq!(state.newest, (0, ChainHash::START));
    assert_eq!(list_files(spool_folder.folder.path()), ["spool.sqlite", "spool.sqlite.damaged-5"]);
}

/// Overwrites `bytes` bytes of the spool's file from byte `from` on.
fn overwrite(path: &std::path::Path, from: u64, bytes: usize) {
    let mut damaged_file = fs::File::options().write(true).open(path).expect("opens");
    damaged_file.seek(SeekFrom::Start(from)).expect("seeks");
    damaged_file.write_all(&vec![0xa5; bytes]).expect("written");
}

#[tokio::test]
async fn intact_batches_of_damaged_spool_are_kept() {
    let spool_folder = SpoolFolder::new();
    let (mut file, before) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=200, 2000);
    file.append(&written_batches, &totals(602)).await.expect("appends");
    file.delete_through(10, written_batches[9].chain).await.expect("deletes");
    drop(file.close().await);
    // Three pages in the middle of the file are damaged, as by a failing memory card.
    let length = fs::metadata(spool_folder.path()).expect("the file exists").len();
    overwrite(&spool_folder.path(), length / 2 / 4096 * 4096, 3 * 4096);

    flag_as_damaged(&spool_folder.path(), "a page was broken");
    let OpenSpool { mut file, state, quarantined, counter, .. } = spool_folder.open().await.expect("opens");
    counter.remove();
    let recovered = quarantined.expect("is quarantined").recovered.expect("some batches are intact");
    assert!((1..190).contains(&recovered.batches), "{recovered:?}");
    assert_eq!(recovered.events, 3 * recovered.batches);
    assert_eq!(recovered.lost_batches, Some(190 - recovered.batches));
    // The stream is unchanged, so the aggregator recognises the recovered batches and stores no batch twice.
    assert_eq!(
        (state.stream, state.oldest, state.chain_before_oldest),
        (before.stream, 11, written_batches[9].chain)
    );
    assert_eq!(state.newest.0, 10 + recovered.batches);
    // The produced events are the stored, the waiting and the dropped ones. Lost events whose number can be read count
    // as dropped.
    assert_eq!((state.totals.produced, state.totals.dropped), (602, 2 + recovered.lost_events));
    assert_eq!(state.totals.reported_drops, state.totals.dropped);
    let loaded = file.load(11, usize::MAX).await.expect("loads");
    assert_eq!(loaded.batches, written_batches[10..10 + recovered.batches as usize]);
    assert_eq!(list_files(spool_folder.folder.path()), ["spool.sqlite", "spool.sqlite.damaged-5"]);
}

#[tokio::test]
async fn batches_of_another_host_are_not_recovered() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    file.append(&batches(ChainHash::START, 1..=5, 100), &totals(15)).await.expect("appends");
    sqlx::query("UPDATE stream SET host = 'another'").execute(file.connection()).await.expect("changed");
    drop(file.close().await);
    flag_as_damaged(&spool_folder.path(), "a page was broken");
    let OpenSpool { state, quarantined, .. } = spool_folder.open().await.expect("opens");
    let reason = quarantined.expect("is quarantined").recovered.expect_err("nothing is recovered");
    assert!(reason.contains("this host as its owner"), "{reason}");
    assert_eq!(state.newest, (0, ChainHash::START));
}

#[tokio::test]
async fn empty_file_is_distinguished_from_new_spool() {
    let spool_folder = SpoolFolder::new();
    assert!(!spool_folder.open().await.expect("opens").was_empty, "the file did not exist");
    let emptied = SpoolFolder::new();
    fs::write(emptied.path(), "").expect("written");
    assert!(emptied.open().await.expect("opens").was_empty);
    assert!(!emptied.open().await.expect("opens").was_empty, "the file now has a spool");
}

#[tokio::test]
async fn damaged_batch_ends_list_and_is_named() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=5, 100);
    file.append(&written_batches, &totals(15)).await.expect("appends");
    sqlx::query("UPDATE batch SET body = zeroblob(100) WHERE number = 3")
        .execute(file.connection())
        .await
        .expect("changed");
    let loaded = file.load(1, usize::MAX).await.expect("loads");
    assert_eq!(loaded.batches, written_batches[..2]);
    let damage = loaded.damage.expect("is reported");
    assert!(damage.contains("batch 3") && damage.contains("was changed"), "{damage}");
    let loaded = file.load(3, usize::MAX).await.expect("loads");
    assert!(loaded.batches.is_empty() && loaded.damage.is_some());
    assert_eq!(
        file.load(4, usize::MAX).await.expect("loads").batches,
        written_batches[3..],
        "the batches after the damaged batch are intact"
    );
}

#[tokio::test]
async fn missing_batch_ends_list() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=5, 100);
    file.append(&written_batches, &totals(15)).await.expect("appends");
    sqlx::query("DELETE FROM batch WHERE number = 3").execute(file.connection()).await.expect("changed");
    assert_eq!(file.load(1, usize::MAX).await.expect("loads").batches, written_batches[..2]);
    let loaded = file.load(3, usize::MAX).await.expect("loads");
    assert!(loaded.batches.is_empty());
    assert!(loaded.damage.expect("is reported").contains("batch 3"), "the damage names the batch");
    assert_eq!(
        file.load(4, usize::MAX).await.expect("loads").batches,
        written_batches[3..],
        "the batches after the missing batch"
    );
    drop(file.close().await);
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.oldest, state.newest.0, state.waiting_usage.events), (1, 5, 12));
}

#[tokio::test]
async fn spool_of_newer_version_is_refused_and_kept() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    sqlx::query(
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
         VALUES (9, 'future', TRUE, x'00', 0)",
    )
    .execute(file.connection())
    .await
    .expect("changed");
    drop(file.close().await);
    let error = spool_folder.open().await.expect_err("the schema is too new").to_string();
    assert!(error.contains("newer version") && error.contains('9'), "{error}");
    assert_eq!(list_files(spool_folder.folder.path()), ["spool.sqlite"]);
}

#[tokio::test]
async fn damaged_page_loses_only_its_batches() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=200, 2000);
    file.append(&written_batches, &totals(600)).await.expect("appends");
    for statement in ["PRAGMA wal_checkpoint(TRUNCATE)", "PRAGMA shrink_memory"] {
        sqlx::query(statement).execute(file.connection()).await.expect("moves all pages to the file");
    }
    let mut damaged_file = fs::File::options().write(true).open(spool_folder.path()).expect("opens");
    damaged_file.seek(SeekFrom::Start(50 * 4096)).expect("seeks");
    damaged_file.write_all(&[0xa5; 4096]).expect("written");

    let (mut readable, mut damaged_count, mut next) = (Vec::new(), 0, 1);
    while next <= 200 {
        let loaded = file.load(next, usize::MAX).await.expect("damage is not an error");
        next += loaded.batches.len() as u64;
        readable.extend(loaded.batches);
        if loaded.damage.is_some() {
            (damaged_count, next) = (damaged_count + 1, next + 1);
        }
    }
    assert!(
        (1..=3).contains(&damaged_count) && readable.len() == 200 - damaged_count,
        "{} readable, {damaged_count} damaged",
        readable.len()
    );
    assert!(readable.iter().all(|batch| written_batches.contains(batch)));
}

#[tokio::test]
async fn damage_flag_without_spool_is_removed() {
    let spool_folder = SpoolFolder::new();
    flag_as_damaged(&spool_folder.path(), "a page was broken");
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!(state.newest, (0, ChainHash::START));
    assert_eq!(quarantine_reason(&spool_folder.path()), None);
    assert!(!with_suffix(&spool_folder.path(), "-condemned").exists());
}
