//! The live stream.

use axum::body::{Body, BodyDataStream};
use axum::http::{Request, StatusCode};
use futures::StreamExt;
use peernet_clock::Span;
use serde_json::Value;

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

/// Reads the events of a live stream one by one.
struct EventReader {
    body: BodyDataStream,
    /// Received text that was not returned yet.
    text: String,
}

impl EventReader {
    async fn subscribe(dashboard: &TestDashboard, topics: &str) -> Self {
        let address = format!("/api/v1/live?topics={topics}");
        let response = dashboard.send(Request::get(address).body(Body::empty()).expect("a request")).await;
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        assert!(!response.headers().contains_key("content-encoding"), "a compressed stream would come late");
        Self { body: response.into_body().into_data_stream(), text: String::new() }
    }

    /// Returns the next event's name and data; `None` at the end of the stream.
    async fn next(&mut self) -> Option<(String, String)> {
        loop {
            if let Some((event, rest)) = self.text.split_once("\n\n") {
                let field = |name: &str| {
                    event
                        .lines()
                        .find_map(|line| line.strip_prefix(name))
                        .unwrap_or_default()
                        .trim()
                        .to_owned()
                };
                let found = (field("event:"), field("data:"));
                self.text = rest.to_owned();
                return Some(found);
            }
            let bytes = self.body.next().await?.expect("the stream is whole");
            self.text.push_str(std::str::from_utf8(&bytes).expect("text"));
        }
    }

    /// Waits for the next event with the name `name`, and returns its data.
    async fn wait_until(&mut self, name: &str) -> Value {
        loop {
            let (event, data) = self.next().await.expect("the stream goes on");
            if event == name {
                return serde_json::from_str(&data).expect("JSON");
            }
        }
    }
}

#[tokio::test]
async fn figures_arrive_as_they_are_reported() {
    let (dashboard, mut site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let mut events = EventReader::subscribe(&dashboard, "picture,overview").await;
    let status = events.wait_until("status").await;
    assert_eq!((&status["connected"], &status["hosts"]), (&Value::from(3), &Value::from(3)));
    let first = events.wait_until("picture").await;
    assert_eq!(first["pipelines"][0]["name"], "local");
    let page = events.wait_until("page").await;
    assert_eq!(page["layout"], "cam-1/local cam-2/offload-full");
    assert!(page["title"].as_str().expect("a title").starts_with("2 pipelines running"));
    assert_eq!(page["parts"][1][0], "now");

    let newest = |event: &Value| {
        event["pipelines"][0]["seconds"].as_array().and_then(|all| all.last()?["at"].as_i64())
    };
    let before = newest(&first);
    let now = dashboard.clock.wall() + Span::from_seconds(2);
    site.report(now, now).await;
    while newest(&events.wait_until("picture").await) <= before {}
}

#[tokio::test]
async fn slow_listener_gets_newest_snapshot_only() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    let mut events = EventReader::subscribe(&dashboard, "picture").await;
    let first = events.wait_until("picture").await;
    // Many snapshots are made while the listener does not read.
    let mut live = dashboard.aggregator.live();
    for _ in 0..8 {
        live.mark_unchanged();
        site.report(dashboard.clock.wall(), dashboard.clock.wall()).await;
        live.changed().await.expect("the aggregator runs");
    }
    let newest = live.borrow_and_update().at;
    let second = events.wait_until("picture").await;
    let at = |event: &Value| {
        let text = event["at"].as_str().expect("a time").to_owned();
        chrono::DateTime::parse_from_rfc3339(&text)
            .expect("RFC 3339")
            .timestamp_nanos_opt()
            .expect("in range")
    };
    assert!(at(&second) >= newest.unix_nanos(), "{} {}", at(&second), newest.unix_nanos());
    assert!(at(&first) < at(&second));
}

#[tokio::test]
async fn pipeline_and_host_pages_are_updated_live() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::full()]).await;
    for (topic, part) in [
        ("pipeline/cam-2/offload-full/10", "title"),
        ("host/cam-2", "title"),
        ("pipelines", "title"),
        ("hosts", "title"),
        ("links", "title"),
        ("link/cam-2~rack-a/10min/removed", "title"),
    ] {
        let page = EventReader::subscribe(&dashboard, topic).await.wait_until("page").await;
        assert_eq!(page["parts"][0][0], part, "{topic}");
    }
}

#[tokio::test]
async fn unchanged_part_is_not_sent_again() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::full()]).await;
    let mut events = EventReader::subscribe(&dashboard, "link/cam-2~rack-a/10min/removed").await;
    let ids = |page: &Value| -> Vec<String> {
        let parts = page["parts"].as_array().expect("parts").iter();
        parts.map(|part| part[0].as_str().expect("an id").to_owned()).collect()
    };
    let first = ids(&events.wait_until("page").await);
    assert!(first.contains(&"chart".to_owned()) && first.contains(&"clocks".to_owned()), "{first:?}");
    let now = dashboard.clock.wall() + Span::from_seconds(4);
    site.report(now - Span::from_seconds(4), now).await;
    let next = loop {
        let next = ids(&events.wait_until("page").await);
        if next.contains(&"chart".to_owned()) {
            break next;
        }
    };
    assert!(!next.contains(&"clocks".to_owned()), "{next:?}");
}

#[tokio::test]
async fn listener_without_topics_gets_status_events() {
    let dashboard = TestDashboard::empty().await;
    let mut events = EventReader::subscribe(&dashboard, "").await;
    assert_eq!(events.wait_until("status").await["hosts"], 0);
    let (name, _) = events.next().await.expect("the stream goes on");
    assert_eq!(name, "heartbeat");
}

#[tokio::test]
async fn stream_ends_when_the_server_stops() {
    let dashboard = TestDashboard::empty().await;
    let mut events = EventReader::subscribe(&dashboard, "picture").await;
    events.wait_until("status").await;
    dashboard.stop.cancel();
    while events.next().await.is_some() {}
}
