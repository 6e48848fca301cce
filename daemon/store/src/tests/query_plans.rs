//! No query may read all nodes, nor all iterations of a run: a page must open at once even if the database has a hundred
//! million nodes.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use sqlx::AssertSqlSafe;

use super::TestStore;
use crate::read::sql;

/// Tables that grow with every iteration or second. A look-up in such a table must use at least one of these lists of
/// columns, in the order of a key. The look-up then reads few rows.
const LARGE_TABLES: [(&str, &[&str]); 7] = [
    ("node", &["run=? AND iteration=?"]),
    ("transit", &["run=? AND iteration=?", "(run,iteration)"]),
    ("anchor", &["run=? AND iteration=?"]),
    ("iteration", &["run=? AND number", "run=? AND warm_up=? AND outcome=? AND "]),
    ("rollup", &["run=? AND resolution_s=?"]),
    ("verdict_count", &["run=?"]),
    ("clock_sample", &["link=? AND at_ns", "link=? AND window=? AND at_raw_ns"]),
];

/// Statements that may read more rows than they return: name, table, and the reason why the number
/// of rows is bounded.
const EXCEPTIONS: [(&str, &str, &str); 4] = [
    ("SHAPES", "node", "the nodes of a few thousand iterations, from one number to another"),
    ("RUN_EXTENT", "iteration", "the first and the last row of the run, LIMIT 1"),
    ("RUN_DELAYS", "transit", "continues after the last row of the previous page, LIMIT"),
    ("LINKS", "clock_sample", "min and max of a key: one row each"),
];

/// Queries that may sort, and the reason why each query sorts few rows.
const SORTING_QUERIES: [(&str, &str); 12] = [
    ("SHAPES", "one row for each of a few thousand iterations"),
    ("SUMS_OVER_TIME", "at most a thousand buckets of a few names, without their sketches"),
    ("RUNS_FILTERED", "the rows of the runs of the requested pipelines only"),
    ("VERDICTS", "at most a handful of rows"),
    ("EXPERIMENTS", "one row for each experiment; their runs come in the order of an index"),
    ("FURTHER_GAPS", "the gaps of one run after the first thousand"),
    ("HOSTS", "all hosts are shown"),
    ("LINKS", "all links are shown"),
    ("RELATION_PERIOD_ORDER", "relation periods begin where a clock is stepped"),
    ("RELATION_PERIODS", "relation periods begin where a clock is stepped"),
    ("ASSUMED_PERIODS", "relation periods begin where a clock is stepped"),
    ("NEWEST_ASSUMED_PERIOD", "relation periods begin where a clock is stepped"),
];

async fn plan(test_store: &TestStore, name: &str, statement: &str) -> Vec<String> {
    let explain = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}"));
    let steps: Vec<(i64, i64, i64, String)> = sqlx::query_as(explain)
        .fetch_all(&test_store.store.readers.pool())
        .await
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(!steps.is_empty(), "{name} has no plan");
    steps.into_iter().map(|(_, _, _, step)| step).collect()
}

/// Returns the faults of a plan, and the exceptions that the plan needs.
fn check_plan(name: &str, steps: &[String]) -> (Vec<String>, HashSet<String>) {
    let (mut faults, mut needed) = (Vec::new(), HashSet::new());
    for step in steps {
        for (table, column_lists) in LARGE_TABLES {
            // A step begins with `SEARCH` or `SCAN` and the name of the table.
            if step.split(' ').nth(1) != Some(table) {
                continue;
            }
            let uses_key = column_lists.iter().any(|columns| step.contains(&format!("({columns}")));
            if uses_key && !step.starts_with("SCAN") {
                continue;
            }
            let excepted = EXCEPTIONS
                .iter()
                .any(|(query, exception_table, _)| (*query, *exception_table) == (name, table));
            if excepted && !step.starts_with("SCAN") {
                needed.insert(format!("{name} of {table}"));
            } else {
                faults.push(format!("{name} reads too much of {table}: {step}"));
            }
        }
        if step.contains("TEMP B-TREE") {
            if SORTING_QUERIES.iter().any(|(query, _)| *query == name) {
                needed.insert(format!("{name} sorts"));
            } else {
                faults.push(format!("{name} sorts: {step}"));
            }
        }
    }
    (faults, needed)
}

#[tokio::test]
async fn every_query_finds_its_rows_by_index() {
    let test_store = TestStore::new().await;
    let (mut all_faults, mut needed) = (Vec::new(), HashSet::new());
    for (name, statement) in sql::ALL {
        let (faults, exceptions) = check_plan(name, &plan(&test_store, name, statement).await);
        all_faults.extend(faults);
        needed.extend(exceptions);
    }
    let excepted = EXCEPTIONS.iter().map(|(name, table, _)| format!("{name} of {table}"));
    let allowed = excepted.chain(SORTING_QUERIES.iter().map(|(name, _)| format!("{name} sorts")));
    all_faults.extend(
        allowed
            .filter(|exception| !needed.contains(exception))
            .map(|exception| format!("an exception is not needed: {exception}")),
    );
    assert!(all_faults.is_empty(), "{}", all_faults.join("\n"));
}

#[tokio::test]
async fn query_that_reads_whole_run_or_sorts_is_detected() {
    let test_store = TestStore::new().await;
    for statement in [
        "SELECT count(*) FROM node",
        "SELECT max(value) FROM node WHERE run = ?1",
        "SELECT min(started_ns) FROM iteration WHERE run = ?1",
        "SELECT number FROM iteration WHERE run = ?1 AND total > 1",
        "SELECT number FROM iteration WHERE run = ?1 AND warm_up = 0 AND outcome = 0",
        "SELECT number FROM iteration WHERE run = ?1 AND number > ?2 ORDER BY started_ns LIMIT 10",
        "SELECT * FROM clock_sample WHERE link = ?1",
    ] {
        assert!(!check_plan("BAD", &plan(&test_store, "BAD", statement).await).0.is_empty(), "{statement}");
    }
}

/// Each statement of the readers is in `sql.rs`, so that the test above checks it.
#[test]
fn all_queries_are_constants_of_sql_module() {
    let read = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/read");
    let mut folders = vec![read];
    let mut query_count = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of this crate") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("a source file");
            let wrong_calls = text.match_indices("sqlx::query").filter(|(at, _)| {
                let rest = &text[at + "sqlx::query".len()..];
                let argument = rest.split_once('(').map_or("", |(_, argument)| argument.trim_start());
                query_count += 1;
                // A variable `statement` always holds a constant of `sql`.
                !argument.starts_with("sql::") && !argument.starts_with("statement)")
            });
            let wrong: Vec<&str> =
                wrong_calls.map(|(at, _)| text[at..].lines().next().unwrap_or_default()).collect();
            assert!(wrong.is_empty(), "{}: {wrong:?}", path.display());
        }
    }
    assert!(query_count > 20, "only {query_count} queries were found");
}

#[tokio::test]
async fn ranks_neighbours_and_experiments_use_their_indexes() {
    let test_store = TestStore::new().await;
    for (statement, index) in [
        (
            sql::SLOWER_COUNT,
            "USING COVERING INDEX iteration_by_total (run=? AND warm_up=? AND outcome=? AND total>?)",
        ),
        (
            sql::NEXT_SLOWER,
            "USING COVERING INDEX iteration_by_total (run=? AND warm_up=? AND outcome=? AND (total,number)>(?,?))",
        ),
        (
            sql::NEXT_FASTER,
            "USING COVERING INDEX iteration_by_total (run=? AND warm_up=? AND outcome=? AND (total,number)<(?,?))",
        ),
        (sql::RUNS_OF_EXPERIMENT, "USING INDEX run_of_experiment (<expr>=?)"),
        (sql::EXPERIMENTS, "USING INDEX run_of_experiment"),
        (sql::PREVIOUS, "USING PRIMARY KEY (run=? AND number<?)"),
        (sql::NEXT, "USING PRIMARY KEY (run=? AND number>?)"),
        (sql::FAILED_ITERATIONS, "USING INDEX iteration_without_answer (run=? AND number>?)"),
        (sql::FAILED_COUNT, "INDEX iteration_without_answer (run=? AND number>?)"),
    ] {
        let steps = plan(&test_store, statement, statement).await;
        assert!(steps.iter().any(|step| step.contains(index)), "{statement}: {steps:?}");
    }
}

/// Returns the number of instructions of SQLite's virtual machine that a query executes. `arguments` are the values of
/// the query's parameters.
async fn count_instructions(test_store: &TestStore, statement: &'static str, arguments: &[i64]) -> u64 {
    let mut connection = test_store.second_connection().await;
    let executed = Arc::new(AtomicU64::new(0));
    let counter = Arc::clone(&executed);
    let count_instruction = move || {
        counter.fetch_add(1, Ordering::Relaxed);
        // `true` lets the query continue.
        true
    };
    connection.lock_handle().await.expect("a connection").set_progress_handler(1, count_instruction);
    let mut query = sqlx::query(statement);
    for argument in arguments {
        query = query.bind(argument);
    }
    query.fetch_all(&mut connection).await.expect("answers");
    executed.load(Ordering::Relaxed)
}

/// The plan of a query does not show whether a `min` or a `LIMIT` ends early. The number of instructions shows it.
#[tokio::test]
async fn queries_of_few_rows_cost_same_in_long_runs() {
    let mut test_store = TestStore::new().await;
    let mut costs = Vec::new();
    for iterations in [20, 1_000] {
        test_store.store_run(iterations).await;
        let run = test_store.count("SELECT max(number) FROM run").await;
        costs.push([
            count_instructions(&test_store, sql::RUN_EXTENT, &[run]).await,
            count_instructions(&test_store, sql::PREVIOUS, &[run, 10]).await,
            count_instructions(&test_store, sql::NEXT, &[run, 10]).await,
            count_instructions(&test_store, sql::ITERATIONS, &[run, 3, 10]).await,
            count_instructions(&test_store, sql::SLOWEST, &[run, 10]).await,
        ]);
    }
    for (short, long) in costs[0].iter().zip(&costs[1]) {
        assert!(*short > 0 && *long <= short + 50, "{costs:?}");
    }
}
