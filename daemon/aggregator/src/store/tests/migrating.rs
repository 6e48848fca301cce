//! A file of the version before: everything in it stays, everything new works.

use std::borrow::Cow;

use peernet_logger::stream::Event;
use sqlx::migrate::Migrator;
use sqlx::{ConnectOptions, Connection};

use super::clocks::sample;
use super::{Bed, Writer, database, generate};

#[tokio::test]
async fn a_database_of_the_version_before_goes_on_as_it_was() {
    // A file with runs, brought back to the schema that had no clocks.
    let mut bed = Bed::new().await;
    bed.run_of(20).await;
    let before = bed.store.stages(1).await.expect("answers");
    let path = bed.path.with_file_name("before.sqlite");
    let mut old = database::writing(&path).connect().await.expect("makes");
    let known = |version: &i64| *version <= 2;
    let migrations: Vec<_> =
        database::MIGRATIONS.iter().filter(|migration| known(&migration.version)).cloned().collect();
    assert_eq!(migrations.len(), 2);
    let migrator = Migrator { migrations: Cow::Owned(migrations), ..Migrator::DEFAULT };
    migrator.run_direct(None, &mut old, false).await.expect("makes the old schema");
    sqlx::query("ATTACH ? AS new")
        .bind(bed.path.to_string_lossy().into_owned())
        .execute(&mut old)
        .await
        .expect("opens");
    for table in [
        "name",
        "host",
        "pipeline",
        "stream",
        "run",
        "iteration",
        "node",
        "anchor",
        "transit",
        "rollup",
        "verdict_count",
        "incident",
        "gap",
        "quarantine",
    ] {
        let copy = format!("INSERT INTO main.{table} SELECT * FROM new.{table}");
        sqlx::raw_sql(sqlx::AssertSqlSafe(copy)).execute(&mut old).await.expect("copies");
    }
    old.close().await.expect("closes");

    let connection = database::open(&path).await.expect("brings the schema up to date");
    bed.writer = Writer::new(path.clone(), connection).await.expect("reads the marks");
    bed.store = super::Store::new(database::readers(&path, 2));
    assert_eq!(bed.store.stages(1).await.expect("answers"), before);
    assert_eq!(bed.count("SELECT count(*) FROM node").await, 20 * 21);
    assert_eq!(bed.store.links().await.expect("answers"), []);
    let recomputed = bed.store.recompute(1).await.expect("answers").expect("exists");
    assert_eq!((recomputed.samples, recomputed.stages.len()), (0, 2));

    let work = bed.batch(vec![Event::Clock(Box::new(sample(bed.cloud, 1, 40)))]);
    bed.commit(&[work]).await;
    let links = bed.store.links().await.expect("answers");
    assert_eq!((links.len(), links[0].first), (1, generate::at(1.0)));
    // Opening it once more changes nothing.
    database::open(&path).await.expect("opens");
}
