//! Roll-ups that the writer updates: the table contains the sum of all added values, in any order, even if cached rows
//! are dropped from memory between commits.

use std::collections::BTreeMap;

use peernet_statistics::{Moments, Sketch, Summary};
use proptest::prelude::*;
use sqlx::{Connection, SqliteConnection};

use crate::database;
use crate::rollups::{Quantity, Rollups, WHOLE_RUN, WIDTHS_S, bucket};

/// Key of a row: run, width, bucket, name, quantity.
pub(super) type Key = (i64, i64, i64, i64, i64);

/// Reads the whole table `rollup`.
pub(super) async fn read_rollups(connection: &mut SqliteConnection) -> BTreeMap<Key, Summary> {
    type Row = (i64, i64, i64, i64, i64, i64, f64, f64, f64, f64, Vec<u8>);
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch FROM rollup",
    )
    .fetch_all(connection)
    .await
    .expect("reads");
    rows.into_iter()
        .map(|(run, width, bucket, name, quantity, count, mean, m2, min, max, sketch)| {
            let moments = Moments { count: count.unsigned_abs(), mean, m2, min, max };
            let sketch = Sketch::from_bytes(&sketch).expect("a sketch");
            ((run, width, bucket, name, quantity), Summary { moments, sketch })
        })
        .collect()
}

/// Asserts that counts, extremes and bins are equal, and that moments agree within 1e-9 of their size.
pub(super) fn assert_same(a: &BTreeMap<Key, Summary>, b: &BTreeMap<Key, Summary>) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for ((key, a), b) in a.iter().zip(b.values()) {
        assert_eq!(a.sketch, b.sketch, "{key:?}");
        let (a, b) = (a.moments, b.moments);
        assert_eq!((a.count, a.min, a.max), (b.count, b.min, b.max), "{key:?}");
        assert!((a.mean - b.mean).abs() <= 1e-9 * a.mean.abs().max(b.mean.abs()), "{key:?} {a:?} {b:?}");
        // The tolerance also depends on the size of the values: if all values of a bucket are equal, `m2` is only a
        // rounding error.
        let magnitude = a.m2.max(b.m2).max(a.count as f64 * a.max.abs().max(a.min.abs()).powi(2) * 1e-6);
        assert!((a.m2 - b.m2).abs() <= 1e-9 * magnitude, "{key:?} {a:?} {b:?}");
    }
}

/// A value: its run, name and second, the value itself, and whether the value is the half width of a delay's bounds
/// ([`Quantity::HalfWidth`]).
type AddedValue = (i64, i64, i64, f64, bool);

/// Action of the test on the roll-ups.
#[derive(Clone, Debug)]
enum Action {
    Commit(Vec<AddedValue>),
    /// A transaction that is rolled back.
    Abort(Vec<AddedValue>),
    /// A restart of the aggregator: all cached rows are lost.
    Restart,
    /// Half of the cached rows are dropped, as if memory were short.
    Evict,
}

fn added_value() -> impl Strategy<Value = AddedValue> {
    // Most values are close to the second 7,200, some are up to two hours older, and some are before 1970.
    let second = prop_oneof![5 => 7_195_i64..7_205, 2 => 0_i64..9_000, 1 => -70_i64..70];
    (1_i64..4, 1_i64..4, second, -1.0..10.0_f64, any::<bool>())
}

fn action() -> impl Strategy<Value = Action> {
    let values = || prop::collection::vec(added_value(), 1..60);
    prop_oneof![
        8 => values().prop_map(Action::Commit),
        1 => values().prop_map(Action::Abort),
        1 => Just(Action::Restart),
        1 => Just(Action::Evict),
    ]
}

fn summary(value: f64) -> Summary {
    let mut summary = Summary::default();
    summary.record(value);
    summary
}

fn add(rollups: &mut Rollups, values: &[AddedValue]) {
    for (run, name, second_s, value, is_half_width) in values {
        let quantity = if *is_half_width { Quantity::HalfWidth } else { Quantity::Value };
        rollups.merge(*run, *name, quantity, *second_s, &summary(*value));
        let (verdict, count) = (1, 1);
        rollups.add_verdicts(*run, *name, verdict, count);
    }
}

async fn execute(connection: &mut SqliteConnection, sql: &'static str) {
    sqlx::query(sql).execute(connection).await.expect("executes");
}

async fn run_actions(actions: Vec<Action>) {
    let folder = tempfile::tempdir().expect("a folder");
    let mut connection = database::open(&folder.path().join("peernet.sqlite")).await.expect("opens");
    let mut rollups = Rollups::default();
    let mut expected = BTreeMap::<Key, Summary>::new();
    let mut verdicts_added = 0;
    for action in actions {
        match action {
            Action::Commit(values) => {
                execute(&mut connection, "BEGIN IMMEDIATE").await;
                add(&mut rollups, &values);
                rollups.write(&mut connection).await.expect("writes");
                execute(&mut connection, "COMMIT").await;
                verdicts_added += values.len();
                for (run, name, second_s, value, is_half_width) in values {
                    for width_s in WIDTHS_S.into_iter().chain([WHOLE_RUN]) {
                        let key = (run, width_s, bucket(second_s, width_s), name, is_half_width.into());
                        expected.entry(key).or_default().merge(&summary(value));
                    }
                }
            }
            Action::Abort(values) => {
                execute(&mut connection, "BEGIN IMMEDIATE").await;
                add(&mut rollups, &values);
                rollups.write(&mut connection).await.expect("writes");
                execute(&mut connection, "ROLLBACK").await;
                rollups.forget();
            }
            Action::Restart => rollups = Rollups::default(),
            Action::Evict => rollups.shrink_to(rollups.bytes() / 2),
        }
    }
    assert_same(&read_rollups(&mut connection).await, &expected);
    let verdicts: i64 = sqlx::query_scalar("SELECT coalesce(sum(count), 0) FROM verdict_count")
        .fetch_one(&mut connection)
        .await
        .expect("counts");
    assert_eq!(verdicts, i64::try_from(verdicts_added).expect("few"));
    connection.close().await.expect("closes");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn rollup_table_holds_sum_of_added_values(actions in prop::collection::vec(action(), 1..25)) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(run_actions(actions));
    }
}

#[tokio::test]
async fn only_newest_buckets_of_each_run_stay_in_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut connection = database::open(&folder.path().join("peernet.sqlite")).await.expect("opens");
    let mut rollups = Rollups::default();
    let mut bytes_in_middle_of_second_hour = 0;
    for second_s in 0..7_200 {
        for name in 1..=3 {
            rollups.merge(1, name, Quantity::Value, second_s, &summary(second_s as f64));
        }
        if second_s % 60 == 59 {
            rollups.write(&mut connection).await.expect("writes");
        }
        if second_s == 5_399 {
            bytes_in_middle_of_second_hour = rollups.bytes();
        }
    }
    // Three names have rows in at most two buckets of each of four widths, and in the bucket of the whole run: 27 rows
    // of a few hundred bytes each.
    assert!(rollups.bytes() < 27 * 600, "{}", rollups.bytes());
    // The memory does not grow with the length of the run.
    assert!(
        rollups.bytes() < bytes_in_middle_of_second_hour * 2,
        "{} {bytes_in_middle_of_second_hour}",
        rollups.bytes()
    );
    rollups.shrink_to(0);
    assert_eq!(rollups.bytes(), 0);
}

/// Tables that grow without a limit.
const LARGE_TABLES: [&str; 12] = [
    "node",
    "iteration",
    "transit",
    "anchor",
    "rollup",
    "verdict_count",
    "clock_sample",
    "run",
    "arrival",
    "link",
    "incident",
    "trimmed",
];

#[tokio::test]
async fn rollup_and_retention_queries_use_keys() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut connection = database::open(&folder.path().join("peernet.sqlite")).await.expect("opens");
    let queries = crate::rollups::QUERIES
        .into_iter()
        .chain(crate::rebuild::QUERIES)
        .chain(crate::retention::statements());
    for (name, statement) in queries {
        let explain = format!("EXPLAIN QUERY PLAN {statement}");
        let steps: Vec<(i64, i64, i64, String)> = sqlx::query_as(sqlx::AssertSqlSafe(explain))
            .fetch_all(&mut connection)
            .await
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        for (_, _, _, step) in &steps {
            let is_scan = LARGE_TABLES.iter().any(|table| step.starts_with(&format!("SCAN {table}")));
            // These partial indexes are small: few runs are pinned, and the aggregator has few incidents.
            let is_small_index =
                step.contains("INDEX run_pinned") || step.contains("INDEX incident_of_aggregator");
            assert!(!is_scan || is_small_index, "{name}: {step}");
            // These two queries may sort, because they read few rows: those of the pinned runs of a link's edge, and
            // those of a few buckets.
            let may_sort = ["PINNED", "BUCKETS"].contains(&name);
            let is_sorting = step.contains("TEMP B-TREE");
            assert!(!is_sorting || may_sort, "{name} sorts: {step}");
        }
    }
}
