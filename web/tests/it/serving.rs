//! Listening, stopping, static files.

use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use peernet_web::{StartError, WebConfig};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_util::sync::CancellationToken;

use crate::test_dashboard::TestDashboard;

/// Maximum number of open connections of a test's server. A quarter of them may be live streams.
const MAX_CONNECTIONS: usize = 16;

#[tokio::test]
async fn server_stops_despite_open_stream() {
    let dashboard = TestDashboard::empty().await;
    let stop = CancellationToken::new();
    let server = peernet_web::serve(
        dashboard.config.clone(),
        dashboard.aggregator.clone(),
        dashboard.clock.clone(),
        stop.clone(),
        MAX_CONNECTIONS,
    )
    .await
    .expect("serves");
    let mut client = TcpStream::connect(server.address()).await.expect("connects");
    client
        .write_all(b"GET /api/v1/live?topics=overview HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .await
        .expect("sends");
    let mut received = String::new();
    while !received.contains("event: page") {
        let mut chunk = [0; 4096];
        let length = client.read(&mut chunk).await.expect("reads");
        assert_ne!(length, 0, "the stream ended early: {received}");
        received.push_str(&String::from_utf8_lossy(&chunk[..length]));
    }
    stop.cancel();
    server.join().await.expect("ends when asked to");
    let mut rest = Vec::new();
    client.read_to_end(&mut rest).await.expect("the connection is closed");
}

/// Sends a request from a local address, and returns its connection.
async fn send_request(server: std::net::SocketAddr, from: &str, head: &str) -> TcpStream {
    let socket = TcpSocket::new_v4().expect("a socket");
    socket.bind(format!("{from}:0").parse().expect("an address")).expect("binds");
    let mut stream = socket.connect(server).await.expect("connects");
    stream.write_all(format!("{head}\r\n\r\n").as_bytes()).await.expect("sends");
    stream
}

/// Reads chunks until the received text contains `marker`, and returns the text.
async fn read_until(stream: &mut TcpStream, marker: &str) -> String {
    let mut received = String::new();
    while !received.contains(marker) {
        let mut chunk = [0; 4096];
        let length = stream.read(&mut chunk).await.expect("reads");
        assert_ne!(length, 0, "closed early: {received}");
        received.push_str(&String::from_utf8_lossy(&chunk[..length]));
    }
    received
}

#[tokio::test]
async fn streams_leave_connections_to_other_requests() {
    const LIVE: &str = "GET /api/v1/live HTTP/1.1\r\nHost: localhost";
    let dashboard = TestDashboard::empty().await;
    let (config, aggregator, clock) =
        (dashboard.config.clone(), dashboard.aggregator.clone(), dashboard.clock.clone());
    let server = peernet_web::serve(config, aggregator, clock, dashboard.stop.clone(), MAX_CONNECTIONS)
        .await
        .expect("serves")
        .address();
    let mut open = Vec::new();
    for _ in 0..4 {
        let mut stream = send_request(server, "127.0.0.1", LIVE).await;
        assert!(read_until(&mut stream, "event: status").await.starts_with("HTTP/1.1 200"));
        open.push(stream);
    }
    let received =
        read_until(&mut send_request(server, "127.0.0.1", LIVE).await, "4 live streams are open, ").await;
    assert!(received.starts_with("HTTP/1.1 503") && received.contains("retry-after: 2"), "{received}");
    assert!(received.contains("application/problem+json"), "{received}");
    // A stream of another address replaces the oldest stream of the first address.
    let mut other = send_request(server, "127.0.0.2", LIVE).await;
    assert!(read_until(&mut other, "event: status").await.starts_with("HTTP/1.1 200"));
    let mut rest = Vec::new();
    open.remove(0).read_to_end(&mut rest).await.expect("closed cleanly");
    for (from, path) in [("127.0.0.1", "/"), ("127.0.0.2", "/readyz"), ("127.0.0.3", "/metrics")] {
        let head = format!("GET {path} HTTP/1.1\r\nHost: localhost");
        assert!(
            read_until(&mut send_request(server, from, &head).await, "\r\n")
                .await
                .starts_with("HTTP/1.1 200"),
            "{path}"
        );
    }
    // If listeners close their streams, others can be opened.
    drop((open, other));
    // The server does not announce that it has noticed the closed streams, so the test asks until a stream opens.
    let open_stream = async {
        loop {
            let received = read_until(&mut send_request(server, "127.0.0.3", LIVE).await, "\r\n").await;
            if received.starts_with("HTTP/1.1 200") {
                break;
            }
            assert!(received.starts_with("HTTP/1.1 503"), "{received}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), open_stream).await.expect("closed streams are noticed");
}

#[tokio::test]
async fn invalid_host_header_is_refused() {
    let dashboard = TestDashboard::empty().await;
    let (config, aggregator, clock) =
        (dashboard.config.clone(), dashboard.aggregator.clone(), dashboard.clock.clone());
    let server = peernet_web::serve(config, aggregator, clock, dashboard.stop.clone(), MAX_CONNECTIONS)
        .await
        .expect("serves")
        .address();
    for (head, status) in [
        ("GET /healthz HTTP/1.1\r\nHost: [::1]:8040", 200),
        ("GET /healthz HTTP/1.0\r\nHost: localhost", 200),
        ("GET http://localhost/healthz HTTP/1.1\r\nHost: localhost", 200),
        ("GET /healthz HTTP/1.1\r\nHost: [::1]evil.example", 400),
        ("GET /healthz HTTP/1.1\r\nHost: localhost:99999999", 400),
        ("GET http://localhost/healthz HTTP/1.1\r\nHost: evil.example", 400),
        ("GET http://evil.example/healthz HTTP/1.1\r\nHost: localhost", 400),
        ("GET http://evil.example/healthz HTTP/1.1\r\nHost: evil.example", 421),
        ("GET /healthz HTTP/1.0", 400),
    ] {
        let received = read_until(&mut send_request(server, "127.0.0.1", head).await, "\r\n").await;
        assert!(received.split(' ').nth(1) == Some(&status.to_string()), "{head}: {received}");
    }
}

#[tokio::test]
async fn port_in_use_is_named_in_the_error() {
    let dashboard = TestDashboard::empty().await;
    let occupied_port = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("binds");
    let listen = occupied_port.local_addr().expect("an address").to_string();
    let config = WebConfig { listen: listen.clone(), ..dashboard.config.clone() };
    let error = peernet_web::serve(
        config,
        dashboard.aggregator.clone(),
        dashboard.clock.clone(),
        dashboard.stop.clone(),
        MAX_CONNECTIONS,
    )
    .await
    .expect_err("the port is taken");
    assert!(matches!(error, StartError::Listen { .. }));
    assert!(error.to_string().contains(&listen) && error.to_string().contains("`listen`"), "{error}");
    // The operating system's message must appear once in the chain of causes, not in every error.
    let cause = std::error::Error::source(&error).expect("the operating system's message").to_string();
    assert!(cause.contains("in use") && !error.to_string().contains(&cause), "{error}: {cause}");
}

#[tokio::test]
async fn foreign_host_names_are_refused_without_authentication() {
    let dashboard = TestDashboard::empty().await;
    let server_names = vec!["dash.example.org".to_owned()];
    let with_name = WebConfig { allow_unauthenticated: true, server_names, ..dashboard.config.clone() };
    for config in [&dashboard.config, &with_name] {
        let router = peernet_web::router(
            config,
            dashboard.aggregator.clone(),
            dashboard.clock.clone(),
            dashboard.stop.clone(),
        );
        let status = async |method: &str, path: &str, host: &str| {
            let request = Request::builder().method(method).uri(path).header("host", host);
            let request = request.header("origin", format!("http://{host}")).body(Body::empty());
            let request = request.expect("a request");
            tower::ServiceExt::oneshot(router.clone(), request).await.expect("answers").status()
        };
        for (method, path) in [("GET", "/"), ("GET", "/api/v1/runs"), ("DELETE", "/api/v1/runs/1/pin")] {
            assert_eq!(status(method, path, "evil.example").await, StatusCode::MISDIRECTED_REQUEST, "{path}");
        }
        for host in ["192.0.2.7:8040", "[2001:db8::1]:8040", "localhost"] {
            assert_eq!(status("GET", "/api/v1/runs", host).await, StatusCode::OK, "{host}");
            // 404 shows that the request was let through: there is no such run.
            assert_eq!(status("DELETE", "/api/v1/runs/1/pin", host).await, StatusCode::NOT_FOUND, "{host}");
        }
        let is_own_name = !config.server_names.is_empty();
        let expected = if is_own_name { StatusCode::OK } else { StatusCode::MISDIRECTED_REQUEST };
        assert_eq!(status("GET", "/", "dash.example.org").await, expected);
    }
    let request = Request::get("/api/v1/runs").header("host", "evil.example").body(Body::empty());
    let answer = dashboard.request(request.expect("a request")).await;
    assert!(answer.json()["detail"].as_str().expect("a detail").contains("server_names"));
}

#[tokio::test]
async fn static_files_are_cached_under_content_hash() {
    let dashboard = TestDashboard::empty().await;
    let home = dashboard.get("/").await;
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
        let answer = dashboard.request(request.expect("a request")).await;
        assert_eq!(answer.status, StatusCode::OK, "{name}");
        assert!(answer.header("cache-control").contains("immutable"), "{name}");
        let gzipped = answer.header("content-encoding") == "gzip";
        assert_eq!(gzipped, name != "inter.woff2", "{name}");
        assert!(answer.body.len() < 250_000, "{name} takes {} bytes", answer.body.len());
    }
    let outdated = dashboard.get("/static/0123456789abcdef/app.css").await;
    assert_eq!(outdated.status, StatusCode::TEMPORARY_REDIRECT);
    assert_eq!(outdated.header("location"), format!("{folder}/app.css"));
    assert_eq!(dashboard.get(&format!("{folder}/secrets.txt")).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn health_and_readiness_are_one_word() {
    let dashboard = TestDashboard::empty().await;
    assert_eq!(dashboard.get("/healthz").await.text(), "alive\n");
    assert_eq!(dashboard.get("/readyz").await.text(), "ready\n");
}
