//! The bare loop, with which the aggregator is compared. It inserts the same rows in the order of their arrival, with
//! many rows per statement, and maintains no roll-ups.

use std::path::Path;
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use sqlx::sqlite::{SqliteArguments, SqliteConnectOptions, SqliteJournalMode, SqliteRow, SqliteSynchronous};
use sqlx::{Arguments, AssertSqlSafe, ConnectOptions, Connection, Row, SqliteConnection, TypeInfo, ValueRef};

use crate::load::LoadPlan;
use crate::report;

/// Number of nodes per transaction: ten times the aggregator's default, so that the bare loop rarely syncs.
const COMMIT_NODES: usize = 100_000;
/// Number of rows that one statement inserts.
const ROWS_PER_STATEMENT: usize = 1_000;
/// Tables that are copied.
const TABLES: [&str; 4] = ["iteration", "node", "anchor", "transit"];

/// Copies the rows of the database `from` into the new database `to` with the same schema. Prints how many seconds the
/// inserts took.
pub(crate) async fn run(from: &Path, to: &Path, plan: &LoadPlan) {
    let mut source = SqliteConnectOptions::new().filename(from).connect().await.expect("opens");
    let mut tables = Vec::new();
    for table in TABLES {
        // In the order of arrival: the first batch of each run, then the second batch of each run, and so on.
        let number = if table == "iteration" { "number" } else { "iteration" };
        let select = format!(
            "SELECT * FROM {table} ORDER BY ({number} - 1) / {}, run, {number}",
            plan.iterations_per_batch
        );
        let mut rows = sqlx::query(AssertSqlSafe(select)).fetch_all(&mut source).await.expect("reads");
        let rows: Vec<_> = rows.drain(..).map(|row| row_values(&row)).collect();
        let statement = |count: usize| -> Arc<str> {
            let row = format!("({})", vec!["?"; rows[0].len()].join(","));
            format!("INSERT INTO {table} VALUES {}", vec![row.as_str(); count].join(",")).into()
        };
        tables.push((statement(ROWS_PER_STATEMENT), statement(rows.len() % ROWS_PER_STATEMENT), rows));
    }
    // The second table is `node`.
    let nodes = tables[1].2.len();
    let mut target = SqliteConnectOptions::new()
        .filename(to)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        // The aggregator's settings, so that a difference in speed does not come from the settings.
        .pragma("cache_size", "-65536")
        .pragma("wal_autocheckpoint", "16000")
        .foreign_keys(false)
        .disable_statement_logging()
        .connect()
        .await
        .expect("opens");
    // `None`: up to the newest migration. `false`: no migration is only marked as applied.
    sqlx::migrate!("../../migrations").run_direct(None, &mut target, false).await.expect("makes the schema");
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "bare")));
    let transactions = nodes.div_ceil(COMMIT_NODES);
    let started_at = clock.mono();
    for index in 0..transactions {
        sqlx::query("BEGIN").execute(&mut target).await.expect("begins");
        for (full_statement, last_statement, rows) in &tables {
            // Each transaction inserts a share of each table. Shares are cut at whole statements so that each of the
            // two statements is prepared once.
            let statements = rows.len().div_ceil(ROWS_PER_STATEMENT);
            let share_start =
                |index: usize| rows.len().min(statements * index / transactions * ROWS_PER_STATEMENT);
            for chunk in rows[share_start(index)..share_start(index + 1)].chunks(ROWS_PER_STATEMENT) {
                let sql = if chunk.len() == ROWS_PER_STATEMENT { full_statement } else { last_statement };
                insert(&mut target, sql, chunk).await;
            }
        }
        sqlx::query("COMMIT").execute(&mut target).await.expect("commits");
    }
    report((clock.mono() - started_at).seconds());
    target.close().await.expect("closes");
}

/// Inserts `rows` with one statement.
async fn insert(target: &mut SqliteConnection, sql: &Arc<str>, rows: &[Vec<SqlValue>]) {
    let mut arguments = SqliteArguments::default();
    arguments.reserve(rows.len() * rows[0].len(), 0);
    for cell in rows.iter().flatten() {
        match cell {
            SqlValue::Null => arguments.add(None::<i64>),
            SqlValue::Integer(value) => arguments.add(*value),
            SqlValue::Real(value) => arguments.add(*value),
            SqlValue::Text(value) => arguments.add(value.as_str()),
        }
        .expect("encodes");
    }
    sqlx::query_with(AssertSqlSafe(Arc::clone(sql)), arguments).execute(target).await.expect("inserts");
}

/// A value of a column.
enum SqlValue {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
}

/// Returns the values of a row's columns.
fn row_values(row: &SqliteRow) -> Vec<SqlValue> {
    (0..row.len())
        .map(|index| {
            let raw = row.try_get_raw(index).expect("a column");
            match raw.type_info().name() {
                _ if raw.is_null() => SqlValue::Null,
                "INTEGER" => SqlValue::Integer(row.get(index)),
                "REAL" => SqlValue::Real(row.get(index)),
                _ => SqlValue::Text(row.get(index)),
            }
        })
        .collect()
}
