//! Runs over time with their episodes, over stored data.

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

/// Returns the attribute `d` of the first SVG path with a CSS class; empty without such a path.
fn path<'a>(html: &'a str, class: &str) -> &'a str {
    let rest = html.split(&format!("<path class=\"{class}\" d=\"")).nth(1).unwrap_or_default();
    rest.split('"').next().unwrap_or_default()
}

#[tokio::test]
async fn runs_with_episodes_are_drawn_over_time() {
    let (dashboard, mut site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    site.store_episodes(400, 100).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let (id, first) = (&listed["experiments"][0]["id"], &listed["experiments"][0]["oldest"]);
    let page = dashboard.get(&format!("/compare?experiment={}", id.as_str().expect("an id"))).await;
    let panel = page.text().split("id=\"cc-h\"").nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("an end tag");
    assert_eq!(panel.matches("<figure>").count(), 2, "{panel}");
    assert!(panel.contains(&format!("<a href=\"/runs/{first}#course\">#{first}</a>")), "{panel}");
    // Every hundredth of the 400 iterations timed out, the first of these during the warm-up.
    assert!(
        panel.contains(
            "4 episodes of 100 steps began, 3 iterations failed, 1 iteration of the warm-up failed, points of "
        ),
        "{panel}"
    );
    assert_eq!(path(panel, "border").matches('M').count(), 3, "{panel}");
    assert_eq!(path(panel, "lost").matches('M').count(), 4, "{panel}");
    assert!(!path(panel, "median").is_empty() && panel.contains("class=\"f-inference\""), "{panel}");
    assert!(panel.contains("class=\"f-upload\"") && panel.contains("class=\"warm-up\""), "{panel}");

    let run = dashboard.get(&format!("/runs/{first}")).await;
    assert!(run.text().contains("id=\"course\""), "{}", run.text());
    assert!(
        run.text().contains(
            "<span class=\"sub\">4 episodes of 100 steps began, 3 iterations failed, 1 iteration of the warm-up failed</span>"
        )
    );
    let data = run.text().split("id=\"data\">").nth(1).and_then(|rest| rest.split('<').next()).expect("data");
    let data: serde_json::Value = serde_json::from_str(data).expect("JSON");
    let length = |name: &str| data[name].as_array().map(Vec::len);
    assert_eq!((length("borders"), length("failed"), length("warm_up")), (Some(3), Some(4), Some(1)));
    assert_eq!(data["warm_up"][0][1], data["borders"][0], "the first episode is the warm-up: {data}");
}

#[tokio::test]
async fn pages_show_p95_over_time_of_slow_run() {
    let slow = TestPipeline { hz: 10.0, ..TestPipeline::local() };
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![slow]).await;
    // A chart with points of 2 s has no percentile: each point has 20 iterations.
    site.store_run_of_each_pipeline(3_000).await;
    let run = dashboard.get("/runs/2").await;
    let label = "aria-label=\"Total over the run: median and 95th percentile of 10 s\"";
    assert!(run.text().contains(label), "{}", run.text());
    let compared = dashboard.get("/compare?runs=1,2").await;
    let panel = compared.text().split("id=\"cc-h\"").nth(1).expect("a panel");
    assert!(panel.contains("points of 10\u{202f}s") && panel.contains("</svg>p95 ("), "{panel}");
}

#[tokio::test]
async fn run_without_episodes_mentions_none() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let page = dashboard.get("/compare?runs=1,2").await;
    let panel = page.text().split("id=\"cc-h\"").nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("an end tag");
    assert!(!panel.contains("episode") && !panel.contains("failed"), "{panel}");
    assert_eq!(panel.matches("<figure>").count(), 2, "{panel}");
    assert!(!dashboard.get("/runs/1").await.text().contains("new episode"));
}
