//! Repair of damaged databases.

use std::os::unix::fs::FileExt;
use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::{NOW, TestStore};
use crate::maintenance::{Examination, RepairError, examine, repair};

/// Sums that must agree after any loss: number of iterations by rows and by the counters of runs, missing events by gaps
/// and by the counters of hosts, number of incomplete trees, and number of nodes by rows minus that by the counters of
/// hosts.
const SUMS: &str = "SELECT (SELECT count(*) FROM iteration), (SELECT sum(ok + failed + lost + timeout + warm_up) FROM run), \
     (SELECT coalesce(sum(count), 0) FROM gap), (SELECT coalesce(sum(missing), 0) FROM host), \
     (SELECT count(*) FROM (SELECT run, iteration, count(*) AS n, max(node) AS last FROM node GROUP BY run, iteration) \
      WHERE n <> last + 1), \
     (SELECT count(*) FROM node) - (SELECT sum(nodes) FROM host)";

async fn connect(path: &Path) -> SqliteConnection {
    SqliteConnectOptions::new().filename(path).connect().await.expect("opens")
}

#[tokio::test]
async fn database_is_consistent_after_repair_of_any_page() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(60).await;
    test_store.store_run(60).await;
    let mut other = test_store.second_connection().await;
    sqlx::query("UPDATE storage_clock SET elapsed_ns = 123456789").execute(&mut other).await.expect("sets");
    // A dropped connection closes some time later. Until then SQLite would not move the write-ahead log into the file.
    other.close().await.expect("closes");
    let TestStore { _folder, path: intact_path, writer, store, .. } = test_store;
    store.close().await;
    let (_, closed) = writer.close().await;
    closed.expect("moves the log into the file");
    let mut connection = connect(&intact_path).await;
    let pages: Vec<(i64, String)> = sqlx::query_as("SELECT pageno, name FROM dbstat ORDER BY pageno")
        .fetch_all(&mut connection)
        .await
        .expect("reads");
    connection.close().await.expect("closes");
    assert!(pages.len() > 40, "{pages:?}");

    let mut remaining_iterations = Vec::new();
    for (page, table) in &pages {
        let path = intact_path.with_file_name(format!("{page}.sqlite"));
        std::fs::copy(&intact_path, &path).expect("copies");
        let file = std::fs::File::options().write(true).open(&path).expect("opens");
        let offset = (page.cast_unsigned() - 1) * 4096;
        file.write_all_at(&[0xa5; 4096], offset).expect("writes");
        let repaired = repair(&path, NOW, "now", |_| {}).await;
        // Page 1 has the file's header and the list of tables. Without them, no row can be found.
        if *page == 1 {
            assert!(matches!(repaired, Err(RepairError::Unreadable { .. })), "{repaired:?}");
            let report = examine(&path, Examination { full: false, now: NOW }).await.expect("opens");
            let advice: Vec<&str> = report.findings.iter().map(|finding| finding.advice.as_str()).collect();
            assert!(advice.iter().any(|advice| advice.contains("newest backup")), "{advice:?}");
            assert!(advice.iter().all(|advice| !advice.contains("--repair")), "{advice:?}");
            continue;
        }
        let repaired =
            repaired.expect("repairs").unwrap_or_else(|| panic!("page {page} of {table} is damaged"));
        assert!(repaired.damaged.is_file() && !repaired.without_log, "{repaired:?}");
        let report = examine(&path, Examination { full: true, now: NOW }).await.expect("opens");
        assert!(report.is_healthy(), "page {page} of {table}: {:?}", report.findings);
        let mut connection = connect(&path).await;
        let (iterations, counted, in_gaps, missing, incomplete_trees, node_difference): (
            i64,
            i64,
            i64,
            i64,
            i64,
            i64,
        ) = sqlx::query_as(SUMS).fetch_one(&mut connection).await.expect("reads");
        let context = format!("page {page} of {table}: {repaired:?}");
        // If the row of a run is lost, the number of the run's lost iterations is unknown.
        if table != "run" {
            assert_eq!((iterations + in_gaps, in_gaps), (120, missing), "{context}");
            assert_eq!(counted, iterations, "{context}");
        }
        assert_eq!((incomplete_trees, node_difference), (0, 0), "{context}");
        let elapsed: i64 = sqlx::query_scalar("SELECT elapsed_ns FROM storage_clock")
            .fetch_one(&mut connection)
            .await
            .expect("reads");
        assert!(elapsed == 123_456_789 || table == "storage_clock", "{context}");
        let arrival_kinds: i64 =
            sqlx::query_scalar("SELECT count(DISTINCT owner || kind) FROM arrival WHERE kind >= 0")
                .fetch_one(&mut connection)
                .await
                .expect("reads");
        // Iterations and four widths of roll-ups.
        let kinds_per_run = 5;
        assert!(
            table != "arrival" || arrival_kinds == 2 * kinds_per_run,
            "both runs have an arrival of every kind: {context}"
        );
        remaining_iterations.push(iterations);
        assert_eq!(repair(&path, NOW, "later", |_| {}).await.expect("checks"), None);
        let _writer = super::open(&path).await;
    }
    // Most pages hold rows of few iterations.
    let small_losses = remaining_iterations.iter().filter(|iterations| **iterations >= 100).count();
    assert!(small_losses * 10 > remaining_iterations.len() * 8, "{remaining_iterations:?}");
}

/// SQLite does not clear the pointer of a deleted cell. On an interior page of a table without row ids, the cell of
/// such a pointer looks like a row.
#[tokio::test]
async fn row_of_deleted_cell_pointer_is_not_salvaged() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(120).await;
    let TestStore { _folder, path, writer, store, .. } = test_store;
    store.close().await;
    writer.close().await.1.expect("moves the log into the file");
    let mut connection = connect(&path).await;
    let pages = |condition| format!("SELECT pageno FROM dbstat WHERE {condition}");
    let interior_pages: Vec<i64> =
        sqlx::query_scalar(AssertSqlSafe(pages("name = 'node' AND pagetype = 'internal'")))
            .fetch_all(&mut connection)
            .await
            .expect("reads");
    let index_page: i64 = sqlx::query_scalar(AssertSqlSafe(pages("name = 'iteration_by_total' LIMIT 1")))
        .fetch_one(&mut connection)
        .await
        .expect("reads");
    let mut rows = Vec::new();
    let tables: Vec<String> = sqlx::query_scalar(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\' \
         AND name NOT LIKE '\\_%' ESCAPE '\\' ORDER BY name",
    )
    .fetch_all(&mut connection)
    .await
    .expect("reads");
    for table in tables {
        let statement = AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
        let count: i64 = sqlx::query_scalar(statement).fetch_one(&mut connection).await.expect("counts");
        rows.push((table, count.cast_unsigned(), 0));
    }
    connection.close().await.expect("closes");

    let file = std::fs::File::options().read(true).write(true).open(&path).expect("opens");
    assert!(!interior_pages.is_empty());
    for page in interior_pages {
        let offset = (page.cast_unsigned() - 1) * 4096;
        let mut bytes = [0; 4096];
        file.read_exact_at(&mut bytes, offset).expect("reads");
        let number = |at: usize| usize::from(u16::from_be_bytes([bytes[at], bytes[at + 1]]));
        // The header of an interior page has 12 bytes. The number of cells is at 3, the start of the cells at 5.
        let pointers_end = 12 + 2 * number(3);
        assert!(pointers_end + 2 <= number(5), "no byte is unused");
        // The first cell is intact. The copy of its pointer lies in the unused bytes.
        file.write_all_at(&bytes[12..14], offset + pointers_end as u64).expect("writes");
    }
    assert_eq!(repair(&path, NOW, "now", |_| {}).await.expect("checks"), None, "the file is intact");

    file.write_all_at(&[0xa5; 4096], (index_page.cast_unsigned() - 1) * 4096).expect("writes");
    let repaired = repair(&path, NOW, "now", |_| {}).await.expect("repairs").expect("an index is damaged");
    let salvaged: Vec<(String, u64, u64)> =
        repaired.tables.into_iter().map(|table| (table.table, table.rows, table.unreadable_ranges)).collect();
    assert_eq!((salvaged, repaired.lost_iterations), (rows, 0));
}

#[tokio::test]
async fn repair_is_refused_while_log_is_in_use() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(20).await;
    let mut reader = test_store.second_connection().await;
    sqlx::raw_sql("BEGIN; SELECT count(*) FROM host").execute(&mut reader).await.expect("reads");
    test_store.store_run(20).await;
    let TestStore { _folder, path, writer, store, .. } = test_store;
    store.close().await;
    writer.close().await.1.expect("closes");

    let refused = repair(&path, NOW, "now", |_| {}).await.expect_err("the log is in use");
    assert!(matches!(refused, RepairError::InUse(_)), "{refused:?}");
    assert!(refused.to_string().contains("stop the process"), "{refused}");

    sqlx::raw_sql("COMMIT").execute(&mut reader).await.expect("ends");
    assert_eq!(repair(&path, NOW, "now", |_| {}).await.expect("checks"), None);
    let iterations: i64 =
        sqlx::query_scalar("SELECT count(*) FROM iteration").fetch_one(&mut reader).await.expect("counts");
    assert_eq!(iterations, 40);
}

/// Returns pseudo-random bytes that depend on the seed only.
fn random_bytes(seed: u64, bytes: usize) -> Vec<u8> {
    let mut state = seed;
    let next = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u8
    };
    (0..bytes).map(next).collect()
}

/// A partly overwritten row may be readable, but with another key.
#[tokio::test]
async fn trees_are_complete_after_repair_of_single_rows() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(60).await;
    let TestStore { _folder, path: intact_path, writer, store, .. } = test_store;
    store.close().await;
    writer.close().await.1.expect("moves the log into the file");
    let mut connection = connect(&intact_path).await;
    let pages: Vec<i64> = sqlx::query_scalar(
        "SELECT pageno FROM dbstat WHERE name = 'node' AND pagetype = 'leaf' ORDER BY pageno",
    )
    .fetch_all(&mut connection)
    .await
    .expect("reads");
    connection.close().await.expect("closes");
    let mut repaired = 0;
    for seed in 0..80_u64 {
        let path = intact_path.with_file_name(format!("{seed}.sqlite"));
        std::fs::copy(&intact_path, &path).expect("copies");
        let page = pages[seed as usize % pages.len()];
        // The offset is in the second half of the page: SQLite fills a page with rows from the end.
        let (offset, bytes) = (2048 + (seed * 137) % 2000, 1 + (seed % 40) as usize);
        let file = std::fs::File::options().write(true).open(&path).expect("opens");
        file.write_all_at(&random_bytes(seed, bytes), (page.cast_unsigned() - 1) * 4096 + offset)
            .expect("writes");
        // A changed value in an intact row is not detected.
        if repair(&path, NOW, "now", |_| {}).await.expect("repairs").is_none() {
            continue;
        }
        repaired += 1;
        let report = examine(&path, Examination { full: true, now: NOW }).await.expect("opens");
        assert!(report.is_healthy(), "seed {seed}: {:?}", report.findings);
        let mut connection = connect(&path).await;
        let (iterations, counted, in_gaps, missing, incomplete_trees, node_difference): (
            i64,
            i64,
            i64,
            i64,
            i64,
            i64,
        ) = sqlx::query_as(SUMS).fetch_one(&mut connection).await.expect("reads");
        assert_eq!((iterations + in_gaps, in_gaps, counted), (60, missing, iterations), "seed {seed}");
        assert_eq!((incomplete_trees, node_difference), (0, 0), "seed {seed}");
    }
    assert!(repaired > 20, "{repaired}");
}
