//! Tests of readiness, of event counts that add up, and of pinned runs.

use axum::body::Body;
use axum::http::{Method, Request, StatusCode};
use peernet_aggregator::Readiness;
use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

use crate::test_dashboard::{Answer, TestDashboard};
use crate::test_site::TestPipeline;

/// Waits until the aggregator can store events if `is_ready` is true, else until it cannot.
async fn wait_until_ready_is(dashboard: &TestDashboard, is_ready: bool) {
    let mut readiness = dashboard.aggregator.readiness();
    readiness.wait_for(|now| (*now == Readiness::Ready) == is_ready).await.expect("the aggregator runs");
}

#[tokio::test]
async fn missing_database_is_reported_until_it_returns() {
    let dashboard = TestDashboard::empty().await;
    assert_eq!(
        (dashboard.get("/readyz").await.status, dashboard.get("/readyz").await.text()),
        (StatusCode::OK, "ready\n")
    );
    assert!(dashboard.get("/runs").await.text().contains("id=\"storing\" role=\"status\" hidden></div>"));

    dashboard.move_database("store.sqlite", "elsewhere.sqlite");
    wait_until_ready_is(&dashboard, false).await;
    let answer = dashboard.get("/readyz").await;
    assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE);
    assert!(answer.header("content-type").starts_with("text/plain"));
    let Readiness::NotStoring(reason) = dashboard.aggregator.current_readiness() else { panic!("not ready") };
    assert_eq!(answer.text(), format!("not ready: {reason}\n"));
    let request = Request::get("/readyz").header("accept", "application/json").body(Body::empty());
    let answer = dashboard.request(request.expect("a request")).await;
    assert_eq!(
        (answer.status, answer.json()),
        (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": reason }))
    );
    assert_eq!(dashboard.get("/healthz").await.status, StatusCode::OK, "the process is alive all the same");
    for path in ["/", "/hosts", "/links", "/nothing"] {
        let page = dashboard.get(path).await;
        assert_eq!(page.status == StatusCode::OK, path != "/nothing", "{path}");
        assert!(
            page.text().contains("id=\"storing\" role=\"status\">Cannot store events: "),
            "{path}: {}",
            page.text()
        );
    }
    assert!(dashboard.get("/metrics").await.text().contains("peernet_aggregator_ready_bool 0\n"));

    dashboard.move_database("elsewhere.sqlite", "store.sqlite");
    wait_until_ready_is(&dashboard, true).await;
    assert_eq!(dashboard.get("/readyz").await.status, StatusCode::OK);
    assert!(!dashboard.get("/").await.text().contains("Cannot store events"));
}

#[tokio::test]
async fn damaged_database_errors_match_readiness() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    let options = SqliteConnectOptions::new().filename(dashboard.database());
    let mut connection = options.connect().await.expect("opens");
    // After this checkpoint, all data is in the database file and none in the write-ahead log.
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut connection).await.expect("carries over");
    let file = std::fs::File::options().write(true).open(dashboard.database()).expect("opens");
    let bytes = file.metadata().expect("is there").len();
    // The first page of 4,096 bytes, with the header, stays intact.
    let noise = vec![0xa5; usize::try_from(bytes - 4096).expect("small")];
    std::os::unix::fs::FileExt::write_all_at(&file, &noise, 4096).expect("writes");

    wait_until_ready_is(&dashboard, false).await;
    let Readiness::NotStoring(reason) = dashboard.aggregator.current_readiness() else { panic!("not ready") };
    assert!(reason.contains("is damaged") && reason.contains("peernetd doctor --repair"), "{reason}");
    let answer = dashboard.get("/api/v1/runs/1/iterations").await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{}", answer.text());
    let detail = answer.json()["detail"].as_str().expect("a detail").to_owned();
    let problem = detail.split_once(": ").map_or("", |(_, problem)| problem);
    assert!(
        problem.contains("is damaged") && reason.contains(problem),
        "{detail} is not what readiness says: {reason}"
    );
}

#[tokio::test]
async fn export_of_unreadable_run_is_an_error() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    let options = SqliteConnectOptions::new().filename(dashboard.database());
    let mut connection = options.connect().await.expect("opens");
    // No version stores a negative number of an episode.
    sqlx::query("UPDATE iteration SET episode = -1").execute(&mut connection).await.expect("writes");
    let answer = dashboard.get("/api/v1/runs/1/export").await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{}", answer.text());
    assert_eq!(answer.header("content-type"), "application/problem+json");
}

#[tokio::test]
async fn agent_and_aggregator_counts_agree_when_idle() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let live_state = dashboard
        .wait_until(|live_state| {
            let is_idle = |host: &peernet_aggregator::HostSnapshot| {
                host.accounting.waiting == 0 && host.accounting.stored == host.stored.events
            };
            live_state.hosts.iter().all(|host| is_idle(host)) && live_state.totals.stored.events > 0
        })
        .await;
    for host in &live_state.hosts {
        let account = &host.accounting;
        assert_eq!(account.produced, account.stored + account.waiting + account.dropped, "{account:?}");
        assert_eq!((account.spooled, account.sent), (account.stored, account.stored), "{account:?}");
        assert_eq!(host.behind, None);
    }
    let hosts = dashboard.get("/api/v1/hosts").await.json();
    let number = |value: &Value| value.as_u64().unwrap_or_else(|| panic!("no number: {value}"));
    let mut all = 0;
    for host in hosts["hosts"].as_array().expect("hosts") {
        let events = &host["now"]["events"];
        let sum = number(&events["acknowledged"]) + number(&events["waiting"]) + number(&events["dropped"]);
        assert_eq!(number(&events["produced"]), sum, "{host}");
        assert_eq!(events["acknowledged"], host["stored"]["events"], "{host}");
        assert_eq!((&events["trouble"], &host["now"]["catching_up"]), (&Value::Null, &Value::Null));
        all += number(&host["stored"]["events"]);
    }
    assert_eq!(all, live_state.totals.stored.events);
    let page = dashboard.get("/hosts/cam-2").await;
    assert!(page.text().contains("produced = acknowledged + waiting + dropped"), "{}", page.text());
}

/// Sends a request to pin (PUT) or unpin (DELETE) a run. `site` is the header `Sec-Fetch-Site` of a browser.
async fn pin(dashboard: &TestDashboard, method: Method, run: &str, site: Option<&str>) -> Answer {
    let mut request = Request::builder().method(method).uri(format!("/api/v1/runs/{run}/pin"));
    if let Some(site) = site {
        request = request.header("sec-fetch-site", site);
    }
    dashboard.request(request.body(Body::empty()).expect("a request")).await
}

#[tokio::test]
async fn pinned_run_is_marked_until_it_is_unpinned() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    let pinned = async || dashboard.get("/api/v1/runs/1").await.json()["pinned"].clone();
    assert_eq!(pinned().await, json!(false));
    let page = dashboard.get("/runs/1").await;
    assert!(
        page.text().contains("id=\"pinned\" hidden")
            && page.text().contains("aria-pressed=\"false\" data-pin=\"/api/v1/runs/1/pin\""),
        "{}",
        page.text()
    );

    for _ in 0..2 {
        let answer = pin(&dashboard, Method::PUT, "1", Some("same-origin")).await;
        assert_eq!((answer.status, answer.text()), (StatusCode::NO_CONTENT, ""));
        assert_eq!(pinned().await, json!(true));
    }
    let page = dashboard.get("/runs/1").await;
    assert!(
        page.text().contains("<span id=\"pinned\">")
            && page.text().contains("aria-pressed=\"true\" data-pin"),
        "{}",
        page.text()
    );
    assert!(dashboard.get("/runs").await.text().contains("#i-pin\"/></svg>pinned"));

    assert_eq!(pin(&dashboard, Method::DELETE, "1", None).await.status, StatusCode::NO_CONTENT);
    assert_eq!(pinned().await, json!(false));
    assert!(!dashboard.get("/runs").await.text().contains("#i-pin\"/></svg>pinned"));
}

#[tokio::test]
async fn run_is_pinned_only_by_requests_of_the_same_origin() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    for site in ["cross-site", "same-site"] {
        let answer = pin(&dashboard, Method::PUT, "1", Some(site)).await;
        assert_eq!(answer.status, StatusCode::FORBIDDEN, "{site}");
        assert_eq!(answer.header("content-type"), "application/problem+json");
    }
    assert_eq!(pin(&dashboard, Method::GET, "1", None).await.status, StatusCode::METHOD_NOT_ALLOWED);
    assert_eq!(dashboard.get("/api/v1/runs/1").await.json()["pinned"], json!(false));
}

#[tokio::test]
async fn pin_of_unknown_run_is_refused() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    for (run, status) in [("77", StatusCode::NOT_FOUND), ("one", StatusCode::BAD_REQUEST)] {
        for method in [Method::PUT, Method::DELETE] {
            let answer = pin(&dashboard, method, run, None).await;
            assert_eq!(answer.status, status, "{}", answer.text());
            assert!(answer.json()["detail"].as_str().expect("a detail").contains(run));
        }
    }
}
