//! Listening, stopping, static files.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use peernet_web::{StartError, WebConfig};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_util::sync::CancellationToken;

use crate::bed::Bed;

#[tokio::test]
async fn a_server_stops_with_a_stream_open() {
    let bed = Bed::empty().await;
    let stop = CancellationToken::new();
    let server =
        peernet_web::serve(bed.config.clone(), bed.aggregator.clone(), bed.clock.clone(), stop.clone())
            .await
            .expect("serves");
    let mut listener = TcpStream::connect(server.address()).await.expect("connects");
    listener
        .write_all(b"GET /api/v1/live?topics=overview HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .await
        .expect("sends");
    let mut heard = String::new();
    while !heard.contains("event: page") {
        let mut chunk = [0; 4096];
        let length = listener.read(&mut chunk).await.expect("reads");
        assert_ne!(length, 0, "the stream ended early: {heard}");
        heard.push_str(&String::from_utf8_lossy(&chunk[..length]));
    }
    stop.cancel();
    server.join().await.expect("ends when asked to");
    let mut rest = Vec::new();
    listener.read_to_end(&mut rest).await.expect("the connection is closed");
}

#[tokio::test]
async fn a_port_in_use_is_named() {
    let bed = Bed::empty().await;
    let taken = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("binds");
    let listen = taken.local_addr().expect("an address").to_string();
    let config = WebConfig { listen: listen.clone(), ..bed.config.clone() };
    let error = peernet_web::serve(config, bed.aggregator.clone(), bed.clock.clone(), bed.stop.clone())
        .await
        .expect_err("the port is taken");
    assert!(matches!(error, StartError::Listen { .. }));
    assert!(error.to_string().contains(&listen) && error.to_string().contains("`listen`"), "{error}");
    // The system's words stand in the chain of causes once, not in every link of it.
    let cause = std::error::Error::source(&error).expect("the system's words").to_string();
    assert!(cause.contains("in use") && !error.to_string().contains(&cause), "{error}: {cause}");
}

#[tokio::test]
async fn names_of_other_machines_are_refused_until_others_are_let_in() {
    let bed = Bed::empty().await;
    let request = |path: &str| {
        Request::get(path).header("host", "rebound.example").body(Body::empty()).expect("a request")
    };
    let answer = bed.request(request("/api/v1/runs")).await;
    assert_eq!(answer.status, StatusCode::MISDIRECTED_REQUEST);
    assert!(answer.json()["detail"].as_str().expect("a detail").contains("allow_unauthenticated"));
    assert_eq!(bed.request(request("/")).await.status, StatusCode::MISDIRECTED_REQUEST);

    let open = WebConfig { allow_unauthenticated: true, ..bed.config.clone() };
    let router = peernet_web::router(&open, bed.aggregator.clone(), bed.clock.clone(), bed.stop.clone());
    let response = tower::ServiceExt::oneshot(router, request("/")).await.expect("answers");
    assert_eq!(response.status(), StatusCode::OK);
}

#[tokio::test]
async fn static_files_are_kept_for_ever_under_the_hash_of_their_contents() {
    let bed = Bed::empty().await;
    let home = bed.get("/").await;
    let start = home.text().find("/static/").expect("an address");
    let folder = home.text()[start..].split('/').take(3).collect::<Vec<_>>().join("/");
    let names = [
        "app.css",
        "theme.js",
        "app.js",
        "live.js",
        "charts.js",
        "live-charts.js",
        "run.js",
        "echarts.min.js",
        "icon.svg",
        "inter.woff2",
        "licences.txt",
    ];
    for name in names {
        let request = Request::get(format!("{folder}/{name}"))
            .header("accept-encoding", "gzip, br")
            .body(Body::empty());
        let answer = bed.request(request.expect("a request")).await;
        assert_eq!(answer.status, StatusCode::OK, "{name}");
        assert!(answer.header("cache-control").contains("immutable"), "{name}");
        let gzipped = answer.header("content-encoding") == "gzip";
        assert_eq!(gzipped, name != "inter.woff2", "{name}");
        assert!(answer.body.len() < 250_000, "{name} takes {} bytes", answer.body.len());
    }
    let old = bed.get("/static/0123456789abcdef/app.css").await;
    assert_eq!(old.status, StatusCode::TEMPORARY_REDIRECT);
    assert_eq!(old.header("location"), format!("{folder}/app.css"));
    assert_eq!(bed.get(&format!("{folder}/secrets.txt")).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn health_is_told_in_a_word() {
    let bed = Bed::empty().await;
    assert_eq!(bed.get("/healthz").await.text(), "alive\n");
    assert_eq!(bed.get("/readyz").await.text(), "ready\n");
}
