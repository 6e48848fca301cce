//! Runs of which the oldest iterations were deleted.

use std::time::Duration;

use axum::http::StatusCode;
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, SqliteConnection};

use crate::test_dashboard::TestDashboard;
use crate::test_site::{TestPipeline, TestSite};

/// Advances the storage clock, by which retention computes ages, by nine days.
async fn age_stored_data(database: &mut SqliteConnection) {
    let nine_days = "UPDATE storage_clock SET elapsed_ns = elapsed_ns + 9 * 86400 * 1000000000";
    sqlx::query(nine_days).execute(database).await.expect("the database can be written");
}

#[tokio::test]
async fn deleted_data_is_named_and_remaining_data_shown() {
    let dashboard = TestDashboard::empty().await;
    let mut site =
        TestSite::new(&dashboard.listening, dashboard.clock.clone(), vec![TestPipeline::local()]).await;
    site.store_run_of_each_pipeline(200).await;
    site.store_run_of_each_pipeline(100).await;
    let (run, is_pinned) = (2, true);
    let run_exists = dashboard.aggregator.pin(run, is_pinned).await.expect("the database can be written");
    assert!(run_exists, "run 2 does not exist");

    let run = async |number: i64| dashboard.get(&format!("/api/v1/runs/{number}")).await.json();
    assert_eq!(run(1).await["deleted_through"], json!(0));
    let options =
        SqliteConnectOptions::new().filename(dashboard.database()).busy_timeout(Duration::from_secs(10));
    let mut database = options.connect().await.expect("opens");
    let deleted = async {
        while run(1).await["deleted_through"] != json!(200) {
            // The age of data counts only from the first pass of retention over it. The test cannot observe that
            // pass, so it repeats the step of the clock.
            age_stored_data(&mut database).await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), deleted).await.expect("run 1 loses its old iterations");

    let incidents = dashboard.get("/api/v1/incidents").await.json();
    // Retention reports an incident per hour of the storage clock, so there may be later ones.
    let is_expected = |incident: &&serde_json::Value| {
        let text = incident["text"].as_str().expect("a sentence");
        text.contains("200 iterations with their trees of 1 run (nodes_days = 7)")
    };
    let incident = incidents["incidents"].as_array().expect("a list").iter().find(is_expected);
    let incident = incident.unwrap_or_else(|| panic!("{incidents}"));
    assert_eq!((&incident["kind"], &incident["host"]), (&json!("retention"), &json!(null)));
    let page = dashboard.get("/incidents").await;
    assert!(
        page.text().contains("aggregator</td>") && page.text().contains("200 iterations"),
        "{}",
        page.text()
    );

    let page = dashboard.get("/runs/1").await;
    assert!(page.text().contains("Iterations 1 to 200"), "{}", page.text());
    assert!(page.text().contains("deleted after 7 days. The statistics remain."), "{}", page.text());
    assert!(page.text().contains("Distribution of total"), "the statistics of run 1 are not shown");
    let stages = dashboard.get("/api/v1/runs/1/stages").await.json();
    assert!(!stages["stages"].as_array().expect("stages").is_empty());
    let list = dashboard.get("/api/v1/runs/1/iterations").await.json();
    assert_eq!(list, json!({ "iterations": [], "next": null }));
    for path in ["/api/v1/runs/1/iterations/7", "/runs/1/iterations/7"] {
        let answer = dashboard.get(path).await;
        assert_eq!(answer.status, StatusCode::GONE, "{path}: {}", answer.text());
        assert!(answer.text().contains("iterations 1 to 200 of run 1 were deleted after 7 days"), "{path}");
    }
    assert_eq!(
        dashboard.get("/runs/1/iterations/201").await.status,
        StatusCode::NOT_FOUND,
        "iteration 201 never existed"
    );

    assert_eq!(run(2).await["deleted_through"], json!(0), "a pinned run loses nothing");
    assert_eq!(dashboard.get("/runs/2/iterations/7").await.status, StatusCode::OK);
    assert!(!dashboard.get("/runs/2").await.text().contains("The statistics remain"));

    // As if iteration 50 had been deleted before the other iterations of run 2 arrived.
    let deleted_out_of_order = "UPDATE run SET nodes_from = 50 WHERE number = 2";
    sqlx::query(deleted_out_of_order).execute(&mut database).await.expect("the database can be written");
    assert_eq!(run(2).await["deleted_through"], json!(50));
    let list = dashboard.get("/api/v1/runs/2/iterations?limit=1").await.json();
    assert_eq!(list["iterations"][0]["number"], json!(1), "{list}");
    for path in ["/api/v1/runs/2/iterations/7", "/runs/2/iterations/7"] {
        assert_eq!(dashboard.get(path).await.status, StatusCode::OK, "{path}");
    }
}
