//! Tests that read the spools in `tests/fixtures/spools`. There is one spool of each migration, as SQL text. Events
//! that wait in a spool of an earlier release must still be sent.
//!
//! After a new migration was added, `cargo test -p peernet-agent write_missing_fixtures -- --ignored` writes its spool.
//! An existing file is never overwritten.

use std::borrow::Cow;
use std::fs;
use std::process::Command;

use peernet_stream::{Event, Incident, IncidentKind, codec};
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::super::file_kind::APPLICATION_ID;
use super::super::open::MIGRATIONS;
use super::range_log::batch;
use super::*;

/// Texts of the events in each fixture.
const EVENT_TEXTS: [&str; 4] = ["first", "second", "third", "fourth"];

fn fixture_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/spools")
}

fn fixture(version: i64) -> PathBuf {
    fixture_folder().join(format!("{version:04}.sql"))
}

async fn connect(path: &Path) -> SqliteConnection {
    SqliteConnectOptions::new().filename(path).create_if_missing(true).connect().await.expect("opens")
}

fn event(text: &str) -> Event {
    Event::Incident(Incident {
        at: WallTime::from_unix_nanos(1_750_000_000_000_000_000),
        kind: IncidentKind::Connected,
        pipeline: None,
        run: None,
        peer: None,
        text: text.to_owned(),
    })
}

/// Copies the spool to the file `copy`, with the schema of the migration `version`.
async fn copy_as_version(spool: &Path, copy: &Path, version: i64) {
    let mut connection = connect(copy).await;
    let migrations = MIGRATIONS.iter().filter(|migration| migration.version <= version).cloned().collect();
    let migrator = Migrator { migrations: Cow::Owned(migrations), ..Migrator::DEFAULT };
    migrator.run_direct(None, &mut connection, false).await.expect("creates the earlier schema");
    let attached = sqlx::query("ATTACH ? AS new").bind(spool.to_string_lossy().into_owned());
    attached.execute(&mut connection).await.expect("opens");
    let tables: Vec<(String, String)> = sqlx::query_as(
        "SELECT s.name, (SELECT group_concat(name, ', ') FROM pragma_table_info(s.name, 'main')) \
         FROM main.sqlite_schema AS s WHERE type = 'table' AND name NOT LIKE '\\_%' ESCAPE '\\'",
    )
    .fetch_all(&mut connection)
    .await
    .expect("lists");
    for (table, columns) in tables {
        let insert = format!("INSERT INTO main.{table} ({columns}) SELECT {columns} FROM new.{table}");
        sqlx::raw_sql(AssertSqlSafe(insert)).execute(&mut connection).await.expect("copies");
    }
    connection.close().await.expect("closes");
}

#[tokio::test]
#[ignore = "writes the files of new migrations"]
async fn write_missing_fixtures() {
    let spool_folder = SpoolFolder::new();
    let (mut file, state) = spool_folder.open_undamaged().await;
    let batch = batch(&clock(), state, &EVENT_TEXTS.map(event));
    file.append(&[batch], &Totals { produced: 4, ..Totals::default() }).await.expect("appends");
    file.close().await.expect("closes");
    fs::create_dir_all(fixture_folder()).expect("a folder");
    for migration in MIGRATIONS.iter().filter(|migration| !fixture(migration.version).exists()) {
        let copy = spool_folder.folder.path().join(format!("{}.sqlite", migration.version));
        copy_as_version(&spool_folder.path(), &copy, migration.version).await;
        let dump = Command::new("sqlite3").arg(&copy).arg(".dump").output().expect("sqlite3 is installed");
        assert!(dump.status.success(), "{}", String::from_utf8_lossy(&dump.stderr));
        let text = String::from_utf8(dump.stdout).expect("SQL is text");
        let text = format!("PRAGMA application_id = {APPLICATION_ID};\n{text}");
        fs::write(fixture(migration.version), text).expect("writes");
    }
}

#[tokio::test]
async fn spool_of_each_migration_is_readable() {
    for migration in MIGRATIONS.iter() {
        let text = fs::read_to_string(fixture(migration.version));
        let text = text.unwrap_or_else(|error| panic!("the fixture of {}: {error}", migration.version));
        let spool_folder = SpoolFolder::new();
        let mut connection = connect(&spool_folder.path()).await;
        sqlx::raw_sql(AssertSqlSafe(text)).execute(&mut connection).await.expect("the fixture is SQL");
        connection.close().await.expect("closes");

        let (mut file, state) = spool_folder.open_undamaged().await;
        assert_eq!((state.oldest, state.newest.0, state.waiting_usage.events), (1, 1, 4));
        assert_eq!(state.totals.produced, 4);
        let loaded = file.load(1, usize::MAX).await.expect("reads");
        assert_eq!(loaded.damage, None);
        let events = loaded
            .batches
            .iter()
            .flat_map(|batch| codec::decode_events(&batch.body, batch.events).expect("events"));
        let expected: Vec<Event> = EVENT_TEXTS.into_iter().map(event).collect();
        assert_eq!(events.collect::<Vec<_>>(), expected, "migration {}", migration.version);
    }
}
