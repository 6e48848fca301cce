//! Problem details: the answers of the REST API and of `/metrics` to requests that they refuse.

use axum::body::Body;
use axum::http::{Method, Request, StatusCode};

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

#[tokio::test]
async fn problem_details_name_the_parameter() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    for (address, status, word) in [
        ("/api/v1/runs?limit=0", 400, "limit"),
        ("/api/v1/runs?limit=many", 400, "limit: \"many\" is not a whole number from 1 to 1000"),
        ("/api/v1/runs?before=x", 400, "before: give a whole number"),
        ("/api/v1/pipelines?window=5", 400, "window: \"5\" is not one of 1, 10 and 60"),
        ("/api/v1/pipelines?stage=", 400, "stage: give 1 to 20 names"),
        ("/api/v1/pipelines/cam-1/nothing?window=x", 400, "window"),
        ("/api/v1/pipelines?stages=total", 400, "stages"),
        ("/api/v1/runs?lmit=3", 400, "lmit"),
        ("/api/v1/runs?pipeline=a/b", 400, "pipeline"),
        ("/api/v1/runs?host=nobody", 400, "nobody"),
        ("/api/v1/runs/one", 400, "one"),
        ("/api/v1/runs/77", 404, "77"),
        ("/api/v1/runs/77/stages", 404, "77"),
        ("/api/v1/runs/77/export", 404, "77"),
        ("/api/v1/runs/1/histogram?bins=501", 400, "bins"),
        ("/api/v1/runs/1/histogram?stage=nothing", 404, "nothing"),
        ("/api/v1/runs/1/series?points=0", 400, "points"),
        ("/api/v1/runs/1/iterations?order=slowest&after=3", 400, "order"),
        ("/api/v1/runs/1/iterations/999999", 404, "999999"),
        ("/api/v1/runs/1/export?format=xml", 400, "format"),
        ("/api/v1/hosts/nobody", 404, "nobody"),
        ("/api/v1/pipelines/cam-1/nothing", 404, "nothing"),
        ("/api/v1/live?topics=everything", 400, "everything"),
        ("/api/v1/nothing", 404, "/api/v1/nothing"),
        ("/api/v1", 404, "/api/v1"),
        ("/api/", 404, "/api/"),
        ("/api", 404, "/api"),
        ("/metrics/nothing", 404, "/metrics/nothing"),
    ] {
        let answer = dashboard.get(address).await;
        assert_eq!(answer.status.as_u16(), status, "{address}: {}", answer.text());
        assert_eq!(answer.header("content-type"), "application/problem+json", "{address}");
        let problem = answer.json();
        assert_eq!(problem["status"], status, "{address}");
        assert_eq!(problem["type"], "about:blank");
        assert!(!problem["title"].as_str().expect("a title").is_empty());
        assert!(problem["detail"].as_str().expect("a detail").contains(word), "{address}: {problem}");
    }
    for address in ["/api/v1/runs", "/metrics", "/readyz"] {
        let request =
            Request::builder().method(Method::POST).uri(address).body(Body::empty()).expect("a request");
        let answer = dashboard.request(request).await;
        assert_eq!(answer.status, StatusCode::METHOD_NOT_ALLOWED, "{address}");
        assert_eq!(answer.header("content-type"), "application/problem+json", "{address}");
        assert_eq!(answer.json()["status"], 405, "{address}");
        assert!(answer.header("allow").contains("GET"), "{address}: {:?}", answer.headers);
    }
}
