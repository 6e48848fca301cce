//! Response length against latency, over stored data.

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

const HEADING: &str = "Response length against latency</h2>";

/// Returns length and latency of the successful iterations after the warm-up, from the file of a run.
fn lengths_and_latencies(csv: &str) -> Vec<(String, String)> {
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    let header = rows.headers().expect("a header").clone();
    let place = |name: &str| header.iter().position(|column| column == name).expect("a column");
    let (length, latency) = (place("download-bytes"), place("inference"));
    let (warm_up, outcome) = (place("warm-up"), place("outcome"));
    let rows = rows.records().map(|row| row.expect("a row"));
    let rows_in_statistics = rows.filter(|row| &row[warm_up] == "0" && &row[outcome] == "ok");
    rows_in_statistics.map(|row| (row[length].to_owned(), row[latency].to_owned())).collect()
}

#[tokio::test]
async fn lengths_of_answers_match_data_file() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::varying_answers(), TestPipeline::full()]).await;
    let rows = lengths_and_latencies(dashboard.get("/api/v1/runs/1/export").await.text());
    assert!(rows.len() > 300 && rows.len() < 400, "{}", rows.len());
    let pairs = dashboard.aggregator.store().value_pairs(1, ["download-bytes", "inference"], 1_000).await;
    let pairs = pairs.expect("answers").points.into_iter();
    let pairs: Vec<_> = pairs.map(|(length, latency)| (length.to_string(), latency.to_string())).collect();
    assert_eq!(pairs, rows);

    let page = dashboard.get("/compare?runs=1,2").await;
    let panel = page.text().split(HEADING).nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("an end tag");
    assert_eq!(
        panel.matches("class=\"joint\"").count(),
        1,
        "the answers of the other run have equal lengths: {panel}"
    );
    let dots = panel.split("class=\"dots d-inference\" d=\"").nth(1).and_then(|rest| rest.split('"').next());
    assert_eq!(
        dots.map(|dots| dots.matches('M').count()),
        Some(rows.len()),
        "one dot per iteration: {panel}"
    );
    assert!(panel.contains(&format!("All {} iterations.", rows.len())), "{panel}");
    assert!(!dashboard.get("/compare?runs=2").await.text().contains(HEADING));
}

#[tokio::test]
async fn long_run_is_drawn_as_sample() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::varying_answers()]).await;
    site.store_experiment(900, 2).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    let panel = page.text().split(HEADING).nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("an end tag");
    assert!(panel.contains(" iterations, evenly spread; histograms of all."), "{panel}");
    assert!(panel.contains("fill-opacity=") && !panel.contains("class=\"dots"), "{panel}");
    assert!(panel.len() < 30_000, "{}", panel.len());
}
