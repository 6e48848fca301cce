//! Tests of the disk space of a spool.

use peernet_stream::ChainHash;

use super::*;

const MIB: u64 = 1 << 20;

async fn file_bytes(file: &mut SpoolFile) -> u64 {
    let pages: i64 =
        sqlx::query_scalar("PRAGMA page_count").fetch_one(file.connection()).await.expect("counts");
    pages.unsigned_abs() * 4096
}

#[tokio::test]
async fn file_size_follows_content_and_shrinks_after_backlog() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=40, MIB as usize);
    for chunk in written_batches.chunks(8) {
        file.append(chunk, &totals(120)).await.expect("appends");
    }
    let full_size = file_bytes(&mut file).await;
    assert!((40 * MIB..42 * MIB).contains(&full_size), "{full_size}");
    assert!(!file.shrink().await.expect("shrinks"), "no page is unused");

    file.delete_through(39, written_batches[38].chain).await.expect("deletes");
    assert_eq!(file_bytes(&mut file).await, full_size, "deleting alone does not shrink the file");
    let mut steps = 0;
    while file.shrink().await.expect("shrinks") {
        steps += 1;
    }
    assert!((7..=9).contains(&steps), "{steps} steps of 4 MiB");
    let size = file_bytes(&mut file).await;
    assert!(size <= 12 * MIB, "{size}");
    assert_eq!(file.load(40, usize::MAX).await.expect("loads").batches, written_batches[39..]);
    file.close().await.expect("closes");
    assert!(std::fs::metadata(spool_folder.path()).expect("the file exists").len() <= 12 * MIB);
}

#[tokio::test]
async fn new_spool_has_required_sqlite_settings() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    // SQLite returns 2 for `INCREMENTAL` and 1 for `NORMAL`.
    for (pragma, expected) in [("auto_vacuum", "2"), ("journal_mode", "wal"), ("synchronous", "1")] {
        let query = format!("SELECT CAST({pragma} AS TEXT) FROM pragma_{pragma}");
        let value: String = sqlx::query_scalar(sqlx::AssertSqlSafe(query))
            .fetch_one(file.connection())
            .await
            .expect("reads the setting");
        assert_eq!(value, expected, "{pragma}");
    }
}
