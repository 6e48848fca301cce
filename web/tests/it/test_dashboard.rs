//! A real aggregator with its pages and API. The simulated site sends it events through its socket.

use std::sync::Arc;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::header::HOST;
use axum::http::{HeaderMap, HeaderValue, Request, StatusCode};
use peernet_aggregator::{Aggregator, AggregatorConfig, LiveState};
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_web::{WebConfig, Zone};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use crate::test_site::{TestPipeline, TestSite};

/// Number of iterations of each stored run.
pub(crate) const ITERATIONS: u64 = 400;

/// An aggregator with its pages and API, without a web port: tests call the router.
pub(crate) struct TestDashboard {
    pub(crate) aggregator: Aggregator,
    pub(crate) clock: SharedClock,
    pub(crate) stop: CancellationToken,
    pub(crate) config: WebConfig,
    /// Address at which the aggregator accepts agents.
    pub(crate) listening: String,
    router: Router,
    /// Its tasks end when this value is dropped.
    _running: peernet_aggregator::RunningAggregator,
    folder: tempfile::TempDir,
}

/// An answer, read to its end.
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn text(&self) -> &str {
        std::str::from_utf8(&self.body).expect("text")
    }

    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("text"))
    }
}

impl TestDashboard {
    /// Starts an aggregator to which no host has reported.
    pub(crate) async fn empty() -> Self {
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("rack-a", "system")));
        let folder = tempfile::tempdir().expect("a folder");
        let stop = CancellationToken::new();
        let config = AggregatorConfig {
            name: Some("rack-a".parse().expect("a name")),
            listen: "tcp://127.0.0.1:0".into(),
            database: folder.path().join("store.sqlite"),
            ..AggregatorConfig::default()
        };
        let running = Aggregator::start(config, clock.clone(), stop.clone()).await.expect("starts");
        let aggregator = running.handle.clone();
        let listening = aggregator.live().borrow().listening.clone();
        let config = WebConfig { listen: "127.0.0.1:0".into(), time_zone: Zone::Utc, ..WebConfig::default() };
        let router = peernet_web::router(&config, aggregator.clone(), clock.clone(), stop.clone());
        Self { aggregator, clock, stop, config, listening, router, _running: running, folder }
    }

    /// Starts an aggregator with a stored run and live data of each pipeline.
    pub(crate) async fn with_pipelines(pipelines: Vec<TestPipeline>) -> (Self, TestSite) {
        let dashboard = Self::empty().await;
        let expected = pipelines.len();
        let mut site = TestSite::new(&dashboard.listening, dashboard.clock.clone(), pipelines).await;
        site.store_run_of_each_pipeline(ITERATIONS).await;
        site.store_incidents().await;
        site.store_clocks(120).await;
        let now = dashboard.clock.wall();
        site.report(now - Span::from_seconds(70), now).await;
        dashboard
            .wait_until(|snapshot| {
                let has_half_a_minute = |series: &[Arc<peernet_aggregator::LiveSecond>]| series.len() >= 30;
                snapshot.pipelines.len() == expected
                    && snapshot.pipelines.iter().all(|one| has_half_a_minute(&one.series))
                    && snapshot.links.iter().all(|link| link.history.len() >= 70)
            })
            .await;
        (dashboard, site)
    }

    /// Returns the database's file.
    pub(crate) fn database(&self) -> std::path::PathBuf {
        self.folder.path().join("store.sqlite")
    }

    /// Renames a file in the folder of the database.
    pub(crate) fn move_database(&self, from: &str, to: &str) {
        std::fs::rename(self.folder.path().join(from), self.folder.path().join(to)).expect("moves");
    }

    /// Waits for a live state that fulfils a condition.
    pub(crate) async fn wait_until(&self, done: impl Fn(&LiveState) -> bool) -> Arc<LiveState> {
        let mut live = self.aggregator.live();
        let snapshot = live.wait_for(|snapshot| done(snapshot)).await.expect("the aggregator runs");
        Arc::clone(&snapshot)
    }

    /// Sends a request, with a Host header as programs do.
    pub(crate) async fn send(&self, mut request: Request<Body>) -> axum::response::Response {
        request.headers_mut().entry(HOST).or_insert(HeaderValue::from_static("127.0.0.1:8040"));
        self.router.clone().oneshot(request).await.expect("the router answers")
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        self.request(Request::get(path).body(Body::empty()).expect("a request")).await
    }

    pub(crate) async fn request(&self, request: Request<Body>) -> Answer {
        let response = self.send(request).await;
        let (head, body) = response.into_parts();
        let body = to_bytes(body, 64 << 20).await.expect("a whole body").to_vec();
        Answer { status: head.status, headers: head.headers, body }
    }
}
