//! No question may read all nodes: a page over a hundred million of them must open at once.

use super::Bed;
use crate::store::read::sql;

/// Tables that grow with every iteration.
const LARGE: [&str; 7] =
    ["node", "iteration", "transit", "anchor", "rollup", "verdict_count", "clock_sample"];

#[tokio::test]
async fn every_question_finds_its_rows_by_an_index() {
    let bed = Bed::new().await;
    for (name, statement) in sql::ALL {
        let explain = format!("EXPLAIN QUERY PLAN {statement}");
        let steps: Vec<(i64, i64, i64, String)> = sqlx::query_as(sqlx::AssertSqlSafe(explain))
            .fetch_all(&bed.store.pool)
            .await
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(!steps.is_empty(), "{name} has no plan");
        for (_, _, _, step) in &steps {
            for table in LARGE {
                let scans = step.starts_with(&format!("SCAN {table}"));
                assert!(!scans, "{name} reads all of {table}: {step}");
            }
        }
        // Pages are cut from an index: sorting would mean reading them all first.
        if [
            "SLOWEST",
            "ITERATIONS",
            "ITERATIONS_WITHOUT_ANSWER",
            "RUNS",
            "INCIDENTS",
            "RUN_DELAYS",
            "CLOCK_SAMPLES",
            "CLOCK_EXCHANGES",
        ]
        .contains(name)
        {
            assert!(!steps.iter().any(|step| step.3.contains("TEMP B-TREE")), "{name} sorts: {steps:?}");
        }
    }
}

#[tokio::test]
async fn counting_the_slower_ones_and_finding_neighbours_touch_the_index_alone() {
    let bed = Bed::new().await;
    for (statement, index) in [
        (
            sql::SLOWER,
            "USING COVERING INDEX iteration_by_total (run=? AND warm_up=? AND outcome=? AND total>?)",
        ),
        (sql::PREVIOUS, "USING PRIMARY KEY (run=? AND number<?)"),
        (sql::NEXT, "USING PRIMARY KEY (run=? AND number>?)"),
        (sql::ITERATIONS_WITHOUT_ANSWER, "USING INDEX iteration_without_answer (run=? AND number>?)"),
    ] {
        let explain = format!("EXPLAIN QUERY PLAN {statement}");
        let steps: Vec<(i64, i64, i64, String)> =
            sqlx::query_as(sqlx::AssertSqlSafe(explain)).fetch_all(&bed.store.pool).await.expect("explains");
        assert!(steps.iter().any(|step| step.3.contains(index)), "{statement}: {steps:?}");
    }
}
