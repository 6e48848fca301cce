//! Requests for every page and API resource, most of them for the long run.

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::header::{ACCEPT_ENCODING, HOST};
use axum::http::{Request, StatusCode};
use peernet_clock::SharedClock;
use serde_json::Value;
use tower::ServiceExt;

/// Number of requests per address.
const REPEATS: usize = 20;
/// Maximum size of an answer, bytes.
const MAX_ANSWER: usize = 64 << 20;

/// Response times of one address.
#[derive(Debug)]
pub(crate) struct ResponseTimes {
    pub(crate) page: String,
    pub(crate) median_ms: f64,
    pub(crate) max_ms: f64,
}

/// Requests each page and resource [`REPEATS`] times.
pub(crate) async fn measure(router: &Router, clock: &SharedClock) -> Vec<ResponseTimes> {
    let mut times = Vec::new();
    for (page, address) in addresses(router).await {
        let mut times_ms = Vec::with_capacity(REPEATS);
        for _ in 0..REPEATS {
            let began = clock.mono();
            get(router, &address, "gzip").await;
            times_ms.push((clock.mono() - began).seconds() * 1e3);
        }
        times_ms.sort_by(f64::total_cmp);
        times.push(ResponseTimes { page, median_ms: times_ms[REPEATS / 2], max_ms: times_ms[REPEATS - 1] });
    }
    times
}

/// Returns the name and the address of each page and resource.
async fn addresses(router: &Router) -> Vec<(String, String)> {
    let newest = &json(router, "/api/v1/runs?limit=12").await["runs"];
    let numbers: Vec<String> =
        newest.as_array().expect("a list").iter().map(|run| run["number"].to_string()).collect();
    // The long run was filled in last, so it is the newest run.
    let run = &numbers[0];
    // The number of the last iteration is slightly higher, because one in 1,000 iterations fails.
    let successful_iterations = newest[0]["counts"]["ok"].as_u64().expect("a count");
    let middle = successful_iterations / 2;
    let (host, pipeline) = (text(&newest[0]["host"]), text(&newest[0]["pipeline"]));
    let link = text(&json(router, "/api/v1/links").await["links"][0]["name"]);
    let experiment = text(&json(router, "/api/v1/experiments?limit=1").await["experiments"][0]["id"]);
    let twelve = numbers.join(",");
    let names = "total,sensing,upload,inference,download";
    [
        ("overview", "/".to_owned()),
        ("pipelines", "/pipelines".to_owned()),
        ("hosts", "/hosts".to_owned()),
        ("host", format!("/hosts/{host}")),
        ("links", "/links".to_owned()),
        ("link, an hour", format!("/links/{link}?range=1h")),
        ("link, a day", format!("/links/{link}?range=24h")),
        ("runs", "/runs".to_owned()),
        ("runs of a pipeline", format!("/runs?pipeline={pipeline}")),
        ("run, with its trust report", format!("/runs/{run}")),
        ("run, distribution of the upload", format!("/runs/{run}?stage=upload&view=cumulative")),
        ("iteration", format!("/runs/{run}/iterations/{middle}")),
        ("compare, no selection", "/compare".to_owned()),
        ("compare, two runs", format!("/compare?runs={},{}", numbers[0], numbers[1])),
        ("compare, twelve runs", format!("/compare?runs={twelve}")),
        ("compare, experiment of 100 runs", format!("/compare?experiment={experiment}")),
        ("incidents", "/incidents".to_owned()),
        ("API: run", format!("/api/v1/runs/{run}")),
        ("API: stages", format!("/api/v1/runs/{run}/stages")),
        ("API: histogram", format!("/api/v1/runs/{run}/histogram?stage=upload")),
        (
            "API: series of five nodes, 2,000 points",
            format!("/api/v1/runs/{run}/series?stages={names}&points=2000"),
        ),
        ("API: trust", format!("/api/v1/runs/{run}/trust")),
        ("API: compare, experiment", format!("/api/v1/compare?experiment={experiment}")),
        ("API: first 1,000 iterations", format!("/api/v1/runs/{run}/iterations?limit=1000")),
        (
            "API: last 100 iterations",
            format!("/api/v1/runs/{run}/iterations?after={}", successful_iterations.saturating_sub(100)),
        ),
        (
            "API: 100 failed iterations",
            format!("/api/v1/runs/{run}/iterations?after={middle}&unsuccessful=true"),
        ),
        ("API: 1,000 slowest iterations", format!("/api/v1/runs/{run}/iterations?order=slowest&limit=1000")),
        ("API: a link's clock, 2,000 points", format!("/api/v1/links/{link}/clock?points=2000")),
    ]
    .map(|(page, address)| (page.to_owned(), address))
    .into()
}

/// Requests an address and returns the answer's body.
async fn get(router: &Router, address: &str, encoding: &str) -> Vec<u8> {
    let request = Request::get(address).header(HOST, "127.0.0.1:8040").header(ACCEPT_ENCODING, encoding);
    let request = request.body(Body::empty()).unwrap_or_else(|error| panic!("{address}: {error}"));
    let response = router.clone().oneshot(request).await.expect("the router answers");
    let (head, body) = response.into_parts();
    let body = to_bytes(body, MAX_ANSWER).await.unwrap_or_else(|error| panic!("{address}: {error}"));
    assert_eq!(head.status, StatusCode::OK, "{address}: {}", String::from_utf8_lossy(&body));
    body.to_vec()
}

async fn json(router: &Router, address: &str) -> Value {
    serde_json::from_slice(&get(router, address, "identity").await).expect("JSON")
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_else(|| panic!("{value} is no text")).to_owned()
}
