//! The databases in `tests/fixtures/databases`, one of each migration, as SQL text: they stay readable.
//!
//! After a new migration, `cargo test -p peernet-store write_missing_fixtures -- --ignored` writes its file. A file that is
//! there is never written again.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use peernet_stream::{Event, Gap, Incident, IncidentKind, RunEnded};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

use super::clocks::sample;
use super::migrating::as_of_version;
use super::{Bed, database, generate, open, readers};
use crate::Store;
use crate::types::{IterationFilter, RunFilter};

/// Iterations of the run in each of them.
const ITERATIONS: u64 = 4;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/databases")
}

fn fixture(version: i64) -> PathBuf {
    folder().join(format!("{version:04}.sql"))
}

/// What is asked of each of them, as text.
async fn answers(store: &Store) -> String {
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

#[tokio::test]
#[ignore = "writes the files of new migrations"]
async fn write_missing_fixtures() {
    let mut bed = Bed::new().await;
    let run = bed.run_of(ITERATIONS).await;
    let ended = Event::RunEnded(RunEnded { run, ended: generate::at(9.0), reason: "stopped".into() });
    let incident = Event::Incident(Incident {
        at: generate::at(1.0),
        kind: IncidentKind::Connected,
        pipeline: "line".parse().ok(),
        run: Some(run),
        peer: None,
        text: "connected".to_owned(),
    });
    let gap = Event::Gap(Gap {
        pipeline: "line".parse().ok(),
        run: Some(run),
        from: generate::at(2.0),
        to: generate::at(3.0),
        count: 3,
        reason: "the agent's spool was full".to_owned(),
    });
    let clock = Event::Clock(Box::new(sample(bed.cloud, 0, 4)));
    let work = bed.batch(vec![incident, gap, clock, ended]);
    bed.commit(&[work]).await;
    fs::create_dir_all(folder()).expect("a folder");
    for migration in database::MIGRATIONS.iter().filter(|migration| !fixture(migration.version).exists()) {
        let path = as_of_version(&bed, migration.version).await;
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
        let mut connection = database::writing(&path).connect().await.expect("makes");
        sqlx::raw_sql(AssertSqlSafe(text)).execute(&mut connection).await.expect("is SQL");
        connection.close().await.expect("closes");

        // Brings the schema up to date; sqlx compares the text of each migration with what was applied.
        drop(open(&path).await);
        let found = answers(&Store::new(readers(&path))).await;
        let expected = expected.get_or_insert_with(|| found.clone());
        let differs = |(found, expected): &(&str, &str)| found != expected;
        assert_eq!(found.lines().zip(expected.lines()).find(differs), None, "migration {version}");
    }
}
