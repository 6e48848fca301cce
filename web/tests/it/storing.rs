//! Tests of readiness, of accounts that add up, and of pinned runs.

use axum::body::Body;
use axum::http::{Method, Request, StatusCode};
use peernet_aggregator::Readiness;
use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

use crate::bed::{Answer, TestDashboard};
use crate::factory::Line;

/// Waits until the aggregator is ready or not.
async fn until(bed: &TestDashboard, ready: bool) {
    let mut readiness = bed.aggregator.readiness();
    readiness.wait_for(|now| (*now == Readiness::Ready) == ready).await.expect("the aggregator runs");
}

#[tokio::test]
async fn missing_database_is_reported_until_it_returns() {
    let bed = TestDashboard::empty().await;
    assert_eq!(
        (bed.get("/readyz").await.status, bed.get("/readyz").await.text()),
        (StatusCode::OK, "ready\n")
    );
    assert!(bed.get("/runs").await.text().contains("id=\"storing\" role=\"status\" hidden></div>"));

    bed.move_database("store.sqlite", "elsewhere.sqlite");
    until(&bed, false).await;
    let answer = bed.get("/readyz").await;
    assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE);
    assert!(answer.header("content-type").starts_with("text/plain"));
    let Readiness::NotStoring(reason) = bed.aggregator.ready() else { panic!("not ready") };
    assert_eq!(answer.text(), format!("not ready: {reason}\n"));
    let request = Request::get("/readyz").header("accept", "application/json").body(Body::empty());
    let answer = bed.request(request.expect("a request")).await;
    assert_eq!(
        (answer.status, answer.json()),
        (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": reason }))
    );
    assert_eq!(bed.get("/healthz").await.status, StatusCode::OK, "the process is alive all the same");
    for path in ["/", "/hosts", "/links", "/nothing"] {
        let page = bed.get(path).await;
        assert_eq!(page.status == StatusCode::OK, path != "/nothing", "{path}");
        assert!(
            page.text().contains("id=\"storing\" role=\"status\">Cannot store events: "),
            "{path}: {}",
            page.text()
        );
    }
    assert!(bed.get("/metrics").await.text().contains("peernet_aggregator_ready_bool 0\n"));

    bed.move_database("elsewhere.sqlite", "store.sqlite");
    until(&bed, true).await;
    assert_eq!(bed.get("/readyz").await.status, StatusCode::OK);
    assert!(!bed.get("/").await.text().contains("Cannot store events"));
}

#[tokio::test]
async fn damaged_database_errors_match_readiness() {
    let (bed, _factory) = TestDashboard::with(vec![Line::local()]).await;
    let options = SqliteConnectOptions::new().filename(bed.database());
    let mut connection = options.connect().await.expect("opens");
    // From then on the file itself is read.
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut connection).await.expect("carries over");
    let file = std::fs::File::options().write(true).open(bed.database()).expect("opens");
    let bytes = file.metadata().expect("is there").len();
    let noise = vec![0xa5; usize::try_from(bytes - 4096).expect("small")];
    std::os::unix::fs::FileExt::write_all_at(&file, &noise, 4096).expect("writes");

    until(&bed, false).await;
    let Readiness::NotStoring(reason) = bed.aggregator.ready() else { panic!("not ready") };
    assert!(reason.contains("is damaged") && reason.contains("peernetd doctor --repair"), "{reason}");
    let answer = bed.get("/api/v1/runs/1/iterations").await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR, "{}", answer.text());
    let detail = answer.json()["detail"].as_str().expect("a detail").to_owned();
    let told = detail.split_once(": ").map_or("", |(_, told)| told);
    assert!(
        told.contains("is damaged") && reason.contains(told),
        "{detail} is not what readiness says: {reason}"
    );
    drop(connection);
}

#[tokio::test]
async fn both_accounts_agree_at_rest() {
    let (bed, _factory) = TestDashboard::with(vec![Line::local(), Line::full()]).await;
    let picture = bed
        .until(|picture| {
            let rests = |host: &peernet_aggregator::HostSnapshot| {
                host.accounting.waiting == 0 && host.accounting.stored == host.stored.events
            };
            picture.hosts.iter().all(|host| rests(host)) && picture.totals.stored.events > 0
        })
        .await;
    for host in &picture.hosts {
        let account = &host.accounting;
        assert_eq!(account.produced, account.stored + account.waiting + account.dropped, "{account:?}");
        assert_eq!((account.spooled, account.sent), (account.stored, account.stored), "{account:?}");
        assert_eq!(host.behind, None);
    }
    let hosts = bed.get("/api/v1/hosts").await.json();
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
    assert_eq!(all, picture.totals.stored.events);
    let page = bed.get("/hosts/cam-2").await;
    assert!(page.text().contains("produced = acknowledged + waiting + lost"), "{}", page.text());
}

async fn pin(bed: &TestDashboard, method: Method, run: &str, site: Option<&str>) -> Answer {
    let mut request = Request::builder().method(method).uri(format!("/api/v1/runs/{run}/pin"));
    if let Some(site) = site {
        request = request.header("sec-fetch-site", site);
    }
    bed.request(request.body(Body::empty()).expect("a request")).await
}

#[tokio::test]
async fn pinned_run_is_marked_until_it_is_unpinned() {
    let (bed, _factory) = TestDashboard::with(vec![Line::local()]).await;
    let pinned = async || bed.get("/api/v1/runs/1").await.json()["pinned"].clone();
    assert_eq!(pinned().await, json!(false));
    let page = bed.get("/runs/1").await;
    assert!(
        page.text().contains("id=\"pinned\" hidden")
            && page.text().contains("aria-pressed=\"false\" data-pin=\"/api/v1/runs/1/pin\""),
        "{}",
        page.text()
    );

    for _ in 0..2 {
        let answer = pin(&bed, Method::PUT, "1", Some("same-origin")).await;
        assert_eq!((answer.status, answer.text()), (StatusCode::NO_CONTENT, ""));
        assert_eq!(pinned().await, json!(true));
    }
    let page = bed.get("/runs/1").await;
    assert!(
        page.text().contains("<span id=\"pinned\">")
            && page.text().contains("aria-pressed=\"true\" data-pin"),
        "{}",
        page.text()
    );
    assert!(bed.get("/runs").await.text().contains("#i-pin\"/></svg>pinned"));

    assert_eq!(pin(&bed, Method::DELETE, "1", None).await.status, StatusCode::NO_CONTENT);
    assert_eq!(pinned().await, json!(false));
    assert!(!bed.get("/runs").await.text().contains("#i-pin\"/></svg>pinned"));
}

#[tokio::test]
async fn other_sites_and_reads_change_nothing() {
    let (bed, _factory) = TestDashboard::with(vec![Line::local()]).await;
    for site in ["cross-site", "same-site"] {
        let answer = pin(&bed, Method::PUT, "1", Some(site)).await;
        assert_eq!(answer.status, StatusCode::FORBIDDEN, "{site}");
        assert_eq!(answer.header("content-type"), "application/problem+json");
    }
    assert_eq!(pin(&bed, Method::GET, "1", None).await.status, StatusCode::METHOD_NOT_ALLOWED);
    assert_eq!(bed.get("/api/v1/runs/1").await.json()["pinned"], json!(false));
    for (run, status) in [("77", StatusCode::NOT_FOUND), ("one", StatusCode::BAD_REQUEST)] {
        for method in [Method::PUT, Method::DELETE] {
            let answer = pin(&bed, method, run, None).await;
            assert_eq!(answer.status, status, "{}", answer.text());
            assert!(answer.json()["detail"].as_str().expect("a detail").contains(run));
        }
    }
}
