//! The databases in `tests/fixtures/databases`, one for each migration, must stay readable. They are stored as SQL
//! text.
//!
//! After a new migration, `cargo test -p peernet-store write_missing_fixtures -- --ignored` writes the file of this
//! migration. An existing file is never overwritten.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use sqlx::migrate::Migrator;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

use super::{database, open, readers};
use crate::Store;
use crate::types::{IterationFilter, RunFilter};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/databases")
}

fn fixture(version: i64) -> PathBuf {
    folder().join(format!("{version:04}.sql"))
}

/// Returns what pages show of a database, as text.
async fn page_content(store: &Store) -> String {
    let run = store.runs(&RunFilter::default()).await.expect("answers").remove(0).number;
    format!(
        "{:#?}\n{:#?}\n{:#?}\n{:#?}\n{:#?}\n",
        store.run(run).await.expect("answers").expect("exists"),
        store.statistics_of(run).await.expect("answers").stages,
        store.iterations(run, &IterationFilter::default()).await.expect("answers"),
        store.iteration(run, 2).await.expect("answers").expect("exists"),
        store.hosts().await.expect("answers"),
    )
}

/// Makes a database of a version from the newest fixture of the earlier versions. All fixtures thus hold the same data.
async fn migrate_fixture(folder: &Path, version: i64) -> PathBuf {
    let earlier_versions = database::MIGRATIONS
        .iter()
        .map(|migration| migration.version)
        .filter(|version_before| *version_before < version);
    let source_version = earlier_versions
        .filter(|version_before| fixture(*version_before).exists())
        .max()
        .expect("the first fixtures exist");
    let text = fs::read_to_string(fixture(source_version)).expect("reads");
    let path = folder.join(format!("{version}.sqlite"));
    let mut connection = database::write_options(&path).connect().await.expect("makes");
    sqlx::raw_sql(AssertSqlSafe(text)).execute(&mut connection).await.expect("is SQL");
    let migrations =
        database::MIGRATIONS.iter().filter(|migration| migration.version <= version).cloned().collect();
    let migrator = Migrator { migrations, ..Migrator::DEFAULT };
    migrator.run_direct(None, &mut connection, false).await.expect("brings the schema up to date");
    connection.close().await.expect("closes");
    path
}

#[tokio::test]
#[ignore = "writes the files of new migrations"]
async fn write_missing_fixtures() {
    let folder = tempfile::tempdir().expect("a folder");
    for migration in database::MIGRATIONS.iter().filter(|migration| !fixture(migration.version).exists()) {
        let path = migrate_fixture(folder.path(), migration.version).await;
        let dump = Command::new("sqlite3").arg(&path).arg(".dump").output().expect("sqlite3 is installed");
        assert!(dump.status.success(), "{}", String::from_utf8_lossy(&dump.stderr));
        fs::write(fixture(migration.version), dump.stdout).expect("writes");
    }
}

#[tokio::test]
async fn database_of_each_migration_is_readable() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut expected: Option<String> = None;
    let mut versions: Vec<i64> = database::MIGRATIONS.iter().map(|migration| migration.version).collect();
    versions.sort_unstable_by(|a, b| b.cmp(a));
    for version in versions {
        let text = fs::read_to_string(fixture(version));
        let text = text.unwrap_or_else(|error| panic!("the fixture of migration {version}: {error}"));
        let path = folder.path().join(format!("{version}.sqlite"));
        let mut connection = database::write_options(&path).connect().await.expect("makes");
        sqlx::raw_sql(AssertSqlSafe(text)).execute(&mut connection).await.expect("is SQL");
        connection.close().await.expect("closes");

        // Migrates to the newest version; sqlx compares the text of each migration with the applied text.
        drop(open(&path).await);
        let content = page_content(&Store::new(readers(&path))).await;
        let expected = expected.get_or_insert_with(|| content.clone());
        let differs = |(content, expected): &(&str, &str)| content != expected;
        assert_eq!(content.lines().zip(expected.lines()).find(differs), None, "migration {version}");
        assert_eq!(content.lines().count(), expected.lines().count(), "lines of migration {version}");
    }
}
