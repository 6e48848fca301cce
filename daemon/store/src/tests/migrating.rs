//! Migration of databases of earlier versions: all data stays, and new features work.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use peernet_logger::stage;
use peernet_stream::Event;
use sqlx::migrate::Migrator;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::clocks::sample;
use super::retention::{day, run_until_done};
use super::rollups::{assert_same, read_rollups};
use super::{NODES_PER_ITERATION, TestStore, database, generate, open};
use crate::retention::Retention;
use crate::types::{IterationFilter, RunFilter};

/// Newest schema version whose roll-ups have only two widths: the whole run and buckets of 10 s.
const LAST_VERSION_WITH_TWO_WIDTHS: i64 = 4;

/// Copies the data into a database of an earlier schema version. The copy has only the columns and the roll-ups of that
/// version.
pub(super) async fn copy_to_version(test_store: &TestStore, version: i64) -> PathBuf {
    let path = test_store.path.with_file_name(format!("version-{version}.sqlite"));
    let mut old = database::write_options(&path).connect().await.expect("makes");
    let migrations: Vec<_> =
        database::MIGRATIONS.iter().filter(|migration| migration.version <= version).cloned().collect();
    let migrator = Migrator { migrations: Cow::Owned(migrations), ..Migrator::DEFAULT };
    // `None` sets no last version, and with `false` no migration is skipped.
    migrator.run_direct(None, &mut old, false).await.expect("makes the old schema");
    sqlx::query("ATTACH ? AS new")
        .bind(test_store.path.to_string_lossy().into_owned())
        .execute(&mut old)
        .await
        .expect("opens");
    let tables: Vec<String> = sqlx::query_scalar(
        "SELECT name FROM main.sqlite_schema WHERE type = 'table' AND name NOT LIKE '\\_%' ESCAPE '\\' \
         AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\' ORDER BY rowid",
    )
    .fetch_all(&mut old)
    .await
    .expect("lists");
    for name in tables {
        let columns: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info(?, 'main')")
            .bind(&name)
            .fetch_all(&mut old)
            .await
            .expect("describes");
        let new_columns: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info(?, 'new')")
            .bind(&name)
            .fetch_all(&mut old)
            .await
            .expect("describes");
        // Columns and tables that later versions dropped have no data to copy. They keep their defaults.
        let columns: Vec<String> =
            columns.into_iter().filter(|column| new_columns.contains(column)).collect();
        if columns.is_empty() {
            continue;
        }
        let columns = columns.join(", ");
        let condition = if name == "rollup" && version <= LAST_VERSION_WITH_TWO_WIDTHS {
            "WHERE resolution_s IN (0, 10)"
        } else {
            ""
        };
        let copy = format!(
            "INSERT OR REPLACE INTO main.{name} ({columns}) SELECT {columns} FROM new.{name} {condition}"
        );
        sqlx::raw_sql(AssertSqlSafe(copy)).execute(&mut old).await.expect("copies");
    }
    old.close().await.expect("closes");
    path
}

/// Returns what pages show of a run, as text. Series have points of ten seconds, which all versions stored.
async fn page_content(test_store: &TestStore) -> String {
    let store = &test_store.store;
    let series = store.series(1, &[stage::UPLOAD, stage::TOTAL], 21).await.expect("answers");
    assert_eq!(series.bucket_s, 10);
    format!(
        "{:?}\n{:?}\n{:?}\n{:?}\n{:?}\n{:?}\n{series:?}",
        store.run(1).await.expect("answers").expect("exists"),
        store.statistics_of(1).await.expect("answers").stages,
        store.histogram(1, "upload", 20).await.expect("answers"),
        store.iterations(1, &IterationFilter::default()).await.expect("answers"),
        store.iteration(1, 17).await.expect("answers").expect("exists"),
        store.hosts().await.expect("answers"),
    )
}

async fn reopen(test_store: &mut TestStore, path: &Path) -> SqliteConnection {
    test_store.writer = open(path).await;
    test_store.store = super::Store::new(super::readers(path));
    database::write_options(path).connect().await.expect("opens")
}

/// The schema of version 5 has roll-ups of all widths, but no experiments.
#[tokio::test]
async fn database_without_experiments_is_migrated_unchanged() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(200).await;
    let expected = (
        test_store.store.run(1).await.expect("answers"),
        test_store.store.statistics_of(1).await.expect("answers").stages,
    );
    let original_rollups = read_rollups(&mut test_store.second_connection().await).await;
    let path = copy_to_version(&test_store, 5).await;
    let mut connection = reopen(&mut test_store, &path).await;
    let migrated = (
        test_store.store.run(1).await.expect("answers"),
        test_store.store.statistics_of(1).await.expect("answers").stages,
    );
    assert_eq!(migrated, expected);
    assert_same(&read_rollups(&mut connection).await, &original_rollups);
    test_store.store_run(20).await;
    assert_eq!(test_store.store.runs(&RunFilter::default()).await.expect("answers").len(), 2);
}

#[tokio::test]
async fn skipped_starts_of_stored_runs_are_counted_once() {
    for version in [1, 6] {
        let mut test_store = TestStore::new().await;
        test_store.store_run_with_skipped_starts().await;
        test_store.store_run(5).await;
        let path = copy_to_version(&test_store, version).await;
        reopen(&mut test_store, &path).await;
        assert_eq!(
            test_store.skipped_starts().await,
            [super::skipped_starts::SKIPPED, 0],
            "version {version}"
        );
        reopen(&mut test_store, &path).await;
        test_store.store_run_with_skipped_starts().await;
        let expected = [super::skipped_starts::SKIPPED, 0, super::skipped_starts::SKIPPED];
        assert_eq!(test_store.skipped_starts().await, expected, "version {version}");
    }
}

#[tokio::test]
async fn database_with_coarse_statistics_is_migrated_unchanged() {
    for version in 1..=LAST_VERSION_WITH_TWO_WIDTHS {
        let mut test_store = TestStore::new().await;
        test_store.store_run(1_000).await;
        let work = test_store.batch(vec![Event::Clock(Box::new(sample(test_store.cloud, 0, 40)))]);
        test_store.commit(&[work]).await;
        let expected = page_content(&test_store).await;
        let links = test_store.store.links().await.expect("answers");
        let recomputed = test_store.store.recompute(1).await.expect("answers").expect("exists");
        let original_rollups = read_rollups(&mut test_store.second_connection().await).await;
        let path = copy_to_version(&test_store, version).await;

        let mut connection = reopen(&mut test_store, &path).await;
        assert_eq!(page_content(&test_store).await, expected, "version {version}");
        assert_eq!(test_store.count("SELECT count(*) FROM node").await, 1_000 * NODES_PER_ITERATION);
        // The migration makes coarser roll-ups from the stored roll-ups. It cannot make finer roll-ups, those of 1 s.
        let coarser = original_rollups.into_iter().filter(|((_, width_s, ..), _)| *width_s != 1).collect();
        assert_same(&read_rollups(&mut connection).await, &coarser);
        assert_eq!(test_store.count("SELECT count(*) FROM rollup_debt").await, 0);
        let minutes = test_store.store.series(1, &[stage::TOTAL], 4).await.expect("answers");
        assert_eq!((minutes.bucket_s, minutes.stages[0].points.len()), (60, 4));
        let all = test_store.store.series(1, &[stage::TOTAL], 1_000).await.expect("answers");
        assert_eq!(all.bucket_s, 10);
        // Version 3 is the first version that stores clock samples.
        if version >= 3 {
            assert_eq!(test_store.store.links().await.expect("answers"), links);
            assert_eq!(test_store.store.recompute(1).await.expect("answers"), Some(recomputed));
        } else {
            assert_eq!(test_store.store.links().await.expect("answers"), []);
            let recomputed = test_store.store.recompute(1).await.expect("answers").expect("exists");
            assert_eq!((recomputed.samples, recomputed.stages.len()), (0, 2));
        }
        // After an update, data of any age stays for a whole retention period. There is thus time to pin runs.
        let mut retention = Retention::new(crate::retention_config::RetentionConfig::default());
        let steps = run_until_done(&mut retention, &mut connection, day(0.9)).await;
        assert_eq!(
            test_store.count("SELECT count(*) FROM node").await,
            1_000 * NODES_PER_ITERATION,
            "{steps} steps"
        );

        let work = test_store.batch(vec![Event::Clock(Box::new(sample(test_store.cloud, 1, 40)))]);
        test_store.commit(&[work]).await;
        let links = test_store.store.links().await.expect("answers");
        assert_eq!((links.len(), links[0].last), (1, generate::at(1.0)));
        // The migration runs once: opening the file again changes no roll-up.
        let migrated_rollups = read_rollups(&mut connection).await;
        reopen(&mut test_store, &path).await;
        assert_same(&read_rollups(&mut connection).await, &migrated_rollups);
    }
}
