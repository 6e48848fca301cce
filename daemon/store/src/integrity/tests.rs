//! Tests of the search for damage in real files, and of the file that records damage.

use std::cell::Cell;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use proptest::prelude::*;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};
use tempfile::TempDir;
use tokio_util::task::TaskTracker;

use super::pages::{self, PageFile, be32};
use super::task::malformed_pages;
use super::{Integrity, PageCheck, log_path};

const PAGE: u64 = 4096;

/// Makes a file with all kinds of pages: a table with row ids, a table without row ids, an index, long records, free
/// pages.
async fn file_with_all_kinds_of_pages(rows: u32) -> (TempDir, PathBuf, SqliteConnection) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("all.sqlite");
    let options = SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let mut connection = options.connect().await.expect("opens");
    let script = format!(
        "CREATE TABLE numbered (id INTEGER PRIMARY KEY, a REAL, b TEXT, c BLOB) STRICT;
         CREATE TABLE clustered (a INTEGER, b TEXT, c BLOB, PRIMARY KEY (b, a)) STRICT, WITHOUT ROWID;
         CREATE INDEX by_text ON numbered (b, a);
         WITH RECURSIVE n (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM n WHERE n < {rows})
         INSERT INTO numbered SELECT n * n, n / 3.0, hex(randomblob(n % 40)), randomblob(iif(n % 97 = 0, 9000, n % 50)) FROM n;
         INSERT INTO clustered SELECT id, b, c FROM numbered;
         DELETE FROM numbered WHERE id BETWEEN 1000000 AND 1700000;"
    );
    sqlx::raw_sql(AssertSqlSafe(script)).execute(&mut connection).await.expect("fills");
    (folder, path, connection)
}

fn overwrite(path: &Path, offset: u64, bytes: &[u8]) {
    let file = File::options().write(true).open(path).expect("opens");
    file.write_all_at(bytes, offset).expect("writes");
}

/// Returns `length` pseudo-random bytes.
fn noise(mut seed: u64, length: usize) -> Vec<u8> {
    let mut next = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as u8
    };
    (0..length).map(|_| next()).collect()
}

#[tokio::test]
async fn intact_file_has_no_malformed_page() {
    let (_folder, path, connection) = file_with_all_kinds_of_pages(1_500).await;
    connection.close().await.expect("closes");
    assert_eq!(PageCheck::find_malformed(&path).expect("reads"), Vec::<u32>::new());
}

#[tokio::test]
async fn overwritten_pages_of_every_tree_are_malformed() {
    let (_folder, path, mut connection) = file_with_all_kinds_of_pages(1_500).await;
    let pages: Vec<u32> = sqlx::query_scalar("SELECT pageno FROM dbstat WHERE pagetype <> 'overflow'")
        .fetch_all(&mut connection)
        .await
        .expect("reads");
    connection.close().await.expect("closes");
    let whole = std::fs::read(&path).expect("reads");
    assert!(pages.len() > 30);
    let mut unseen = 0;
    // Page 1 is left out: it also has the header of the file.
    for &page in &pages[1..] {
        // Overwrites the whole page with noise, the whole page with zeros, and then the last 1,096 bytes with noise.
        let offset = u64::from(page - 1) * PAGE;
        for (at, bytes) in
            [(0, noise(page.into(), 4096)), (0, vec![0; 4096]), (3_000, noise(page.into(), 1_096))]
        {
            overwrite(&path, offset + at, &bytes);
            let is_seen = PageCheck::find_malformed(&path).expect("reads").contains(&page);
            assert!(is_seen || at > 0, "page {page} was overwritten from its beginning, but is not reported");
            unseen += usize::from(!is_seen);
            overwrite(&path, offset, &whole[offset as usize..(offset + PAGE) as usize]);
        }
    }
    // The last bytes may be contents of one large row, where any bytes are valid.
    assert!(
        unseen * 20 < pages.len(),
        "{unseen} of {} partly overwritten pages are not reported",
        pages.len()
    );
    assert_eq!(PageCheck::find_malformed(&path).expect("reads"), Vec::<u32>::new());

    let pages = whole.len() as u64 / PAGE;
    File::options().write(true).open(&path).expect("opens").set_len(20 * PAGE + 7).expect("cuts it off");
    let malformed = PageCheck::find_malformed(&path).expect("reads");
    // Page 21 is the first page that is not whole.
    assert!(pages > 21 && malformed.contains(&21), "{malformed:?}");
}

/// Opens a connection to a new database with a write-ahead log and a table of long records.
async fn growing_file(path: &Path) -> SqliteConnection {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Off)
        .pragma("wal_autocheckpoint", "0");
    let mut connection = options.connect().await.expect("opens");
    run(
        &mut connection,
        "CREATE TABLE long (a INTEGER PRIMARY KEY, b BLOB); CREATE INDEX by_content ON long (b)",
    )
    .await;
    run(&mut connection, &long_records(300)).await;
    connection
}

async fn run(connection: &mut SqliteConnection, script: &str) {
    sqlx::raw_sql(AssertSqlSafe(script.to_owned())).execute(connection).await.expect("executes");
}

fn long_records(rows: u32) -> String {
    format!(
        "WITH RECURSIVE n (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM n WHERE n < {rows})
         INSERT INTO long (b) SELECT randomblob(iif(n % 3 = 0, 9000, 100)) FROM n"
    )
}

fn malformed(path: &Path, log: PathBuf) -> Vec<u32> {
    let file = Arc::new(File::open(path).expect("opens"));
    let mut check = PageCheck::start(file, log).expect("reads").expect("a database");
    while check.step(20 * PAGE).expect("reads") {}
    check.finish().expect("reads")
}

#[tokio::test]
async fn pages_referenced_only_by_log_are_in_use() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("mixed.sqlite");
    let mut writer = growing_file(&path).await;
    run(&mut writer, "PRAGMA wal_checkpoint(TRUNCATE)").await;
    run(&mut writer, &long_records(300)).await;
    let mut reader = SqliteConnectOptions::new().filename(&path).connect().await.expect("opens");
    run(&mut reader, "BEGIN; SELECT count(*) FROM long").await;
    run(&mut writer, &long_records(300)).await;
    // The checkpoint copies the pages that the reader sees, without the pages of which the write-ahead log has a newer
    // version. It copies the overflow pages of long records, but not the pages that refer to them.
    run(&mut writer, "PRAGMA wal_checkpoint(PASSIVE)").await;
    let missing_log = folder.path().join("none");
    assert_ne!(malformed(&path, missing_log), Vec::<u32>::new());
    assert_eq!(malformed(&path, log_path(&path)), Vec::<u32>::new());
}

#[tokio::test]
async fn damaged_page_is_found_although_log_has_intact_copy() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("idle.sqlite");
    let mut writer = growing_file(&path).await;
    // Everything is checkpointed and nothing is written after that. Therefore SQLite reads the pages from the main
    // file, although the log still has copies of them.
    run(&mut writer, "PRAGMA wal_checkpoint(PASSIVE)").await;
    overwrite(&path, 2 * PAGE, &noise(3, 4096));
    assert_eq!(malformed(&path, log_path(&path)), [3]);
    File::options().write(true).open(&path).expect("opens").set_len(100 * PAGE).expect("cuts it off");
    assert!(malformed(&path, log_path(&path)).contains(&101));
}

#[tokio::test]
async fn page_moved_during_first_pass_is_fine_in_second_pass() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("grows.sqlite");
    let mut writer = growing_file(&path).await;
    run(&mut writer, "PRAGMA wal_checkpoint(TRUNCATE)").await;

    let file = Arc::new(File::open(&path).expect("opens"));
    let mut check = PageCheck::start(file, log_path(&path)).expect("reads").expect("a database");
    assert!(check.step(20 * PAGE).expect("reads"));
    run(&mut writer, &long_records(300)).await;
    run(&mut writer, "DELETE FROM long WHERE a % 5 = 0").await;
    run(&mut writer, "PRAGMA wal_checkpoint(PASSIVE)").await;
    run(&mut writer, &long_records(30)).await;
    while check.step(20 * PAGE).expect("reads") {}
    assert_ne!(check.finish().expect("reads"), Vec::<u32>::new());
    assert_eq!(malformed(&path, log_path(&path)), Vec::<u32>::new());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_page_of_busy_database_is_malformed_in_every_pass() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("busy.sqlite");
    let mut writer = growing_file(&path).await;
    let file = Arc::new(File::open(&path).expect("opens"));
    let reading = SqliteConnectOptions::new().filename(&path).read_only(true);
    let busy = tokio::spawn(async move {
        let mut reader = reading.connect().await.expect("opens");
        run(&mut reader, "BEGIN; SELECT count(*) FROM long").await;
        for round in 1..200 {
            if round % 4 == 0 {
                // The next checkpoints must leave out the pages that this reader uses.
                run(&mut reader, "COMMIT; BEGIN; SELECT count(*) FROM long").await;
            }
            run(&mut writer, &long_records(40)).await;
            run(&mut writer, "DELETE FROM long WHERE a % 7 = (SELECT count(*) FROM long) % 7").await;
            run(&mut writer, "PRAGMA wal_checkpoint(PASSIVE)").await;
        }
    });
    let bytes_per_second = 64 << 20;
    let (reads, mut checks, mut findings) = (TaskTracker::new(), 0, Vec::new());
    while !busy.is_finished() {
        let malformed = malformed_pages(&path, &file, &reads, bytes_per_second).await.expect("reads");
        checks += 1;
        findings.extend(Some(malformed).filter(|pages| !pages.is_empty()));
    }
    busy.await.expect("writes");
    assert!(checks > 5, "{checks} checks");
    assert_eq!(findings, Vec::<Vec<u32>>::new(), "in {checks} checks");
}

#[tokio::test]
async fn first_damage_survives_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("peernet.sqlite");
    let integrity = Integrity::new(&path);
    integrity.load_record().expect("no damage is recorded");
    integrity.record_damage("page 7 is malformed");
    integrity.record_damage("page 8 is malformed");
    let message = integrity.damage_message().expect("damage is recorded");
    assert!(
        message.contains("page 7") && message.contains("peernetd doctor --repair --database"),
        "{message}"
    );
    let later = Integrity::new(&path);
    later.load_record().expect("reads");
    assert_eq!(later.damage().as_deref(), Some("page 7 is malformed"));
    later.clear().expect("removes");
    assert_eq!(later.damage(), None);
    later.load_record().expect("reads");
    assert_eq!(later.damage(), None);
}

#[tokio::test]
async fn repair_is_recommended_only_if_it_can_help() {
    let (_folder, path, connection) = file_with_all_kinds_of_pages(100).await;
    connection.close().await.expect("closes");
    let file = Arc::new(File::open(&path).expect("opens"));
    let integrity = Integrity::new(&path);
    integrity.attach_file(&file);
    integrity.record_damage("page 7 is malformed");
    assert!(integrity.damage_message().is_some_and(|message| message.contains("doctor --repair")));

    overwrite(&path, 0, &noise(1, 4096));
    // Both orders occur: damage is recorded before the file is attached (after a restart), and after it is attached.
    integrity.attach_file(&file);
    let other = Integrity::new(&path);
    other.attach_file(&file);
    other.record_damage("page 1 is malformed");
    for integrity in [integrity, other] {
        let message = integrity.damage_message().expect("damage is recorded");
        assert!(message.contains("newest backup") && !message.contains("--repair"), "{message}");
    }
}

#[tokio::test]
async fn cyclic_list_of_free_pages_ends() {
    let (_folder, path, connection) = file_with_all_kinds_of_pages(1_500).await;
    connection.close().await.expect("closes");
    let trunk = be32(&std::fs::read(&path).expect("reads"), 32);
    assert!(trunk > 1, "the file has free pages");
    // The header states a million free pages. The first page of the list has no free pages and refers to itself.
    overwrite(&path, 36, &1_000_000_u32.to_be_bytes());
    overwrite(&path, u64::from(trunk - 1) * PAGE, &[trunk.to_be_bytes(), [0; 4]].concat());
    let file = PageFile::open(&path).expect("opens").expect("a database");
    let reads = Cell::new(0_u32);
    let free_pages = file.free_pages(|_| {
        reads.set(reads.get() + 1);
        Ok(None)
    });
    assert_eq!(free_pages.expect("reads"), None);
    assert!(reads.get() <= file.page_count, "{} reads", reads.get());
}

#[tokio::test]
async fn cyclic_overflow_chain_is_no_record() {
    let (_folder, path, connection) = file_with_all_kinds_of_pages(100).await;
    connection.close().await.expect("closes");
    // Pages 2 and 3 refer to each other.
    overwrite(&path, PAGE, &3_u32.to_be_bytes());
    overwrite(&path, 2 * PAGE, &2_u32.to_be_bytes());
    let file = PageFile::open(&path).expect("opens").expect("a database");
    // The stated length is that of 4,100 pages, many more than the file has.
    let record_bytes = 1 << 24;
    let cell =
        pages::Cell { child: None, rowid: Some(1), local_content: &[], record_bytes, overflow: Some(2) };
    let mut reads = 0_u32;
    let record = file.record_from_pages(&cell, |page| {
        reads += 1;
        file.read(page, 1)
    });
    assert_eq!(record.expect("reads"), None);
    assert!(reads <= file.page_count, "{reads} reads of {} pages", file.page_count);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn arbitrary_bytes_cause_no_panic(seed: u64, pages in 1_u64..8, cells in 0_u8..200) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("noise.sqlite");
        let mut bytes = noise(seed, (pages * PAGE) as usize);
        let mut header = b"SQLite format 3\0\x10\0\x02\x02\0\x40\x20\x20".to_vec();
        header.resize(100, 0);
        bytes[..100].copy_from_slice(&header);
        // Pages that begin like b-tree pages: the kind of the page, its number of cells, and where the contents of the
        // cells begin.
        for page in 0..pages as usize {
            let start = page * PAGE as usize + if page == 0 { 100 } else { 0 };
            let kind = [2, 5, 10, 13][(seed as usize + page) % 4];
            bytes[start..start + 8].copy_from_slice(&[kind, 0, 0, 0, cells, 2, 0, 0]);
        }
        std::fs::write(&path, bytes).expect("writes");
        let _malformed = PageCheck::find_malformed(&path).expect("reads");
    }
}
