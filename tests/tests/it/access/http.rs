//! Tests of the web port over plain sockets.

use std::io::{Read, Write};
use std::net::TcpStream;

use peernet_tests::{LoopbackDeployment, Process, TEST_TIMEOUT, wait_until};

/// Returns the first line of the answer to a request. The answer may be incomplete if the server closes early.
fn answer(deployment: &LoopbackDeployment, request: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", deployment.http_port)).expect("connects");
    stream.set_read_timeout(Some(TEST_TIMEOUT)).expect("the timeout is not zero");
    let _ = stream.write_all(request.as_bytes());
    let mut text = Vec::new();
    let _ = stream.read_to_end(&mut text);
    String::from_utf8_lossy(&text).lines().next().unwrap_or_default().to_owned()
}

/// Starts an aggregator whose dashboard needs no authentication.
fn start_without_authentication(deployment: &LoopbackDeployment) -> Process {
    let text = peernet_tests::AGGREGATOR.replace("[web]\n", "[web]\nallow_unauthenticated = true\n");
    deployment.write("aggregator.toml", &text);
    let process = deployment.start("aggregator.toml");
    process.wait_for("dashboard: http://");
    process
}

#[test]
fn foreign_host_header_is_refused_on_open_dashboard() {
    let deployment = LoopbackDeployment::new();
    let _aggregator = start_without_authentication(&deployment);
    // No run is stored, so the last request finds none.
    for (method, path, status) in
        [("GET", "/", 200), ("GET", "/api/v1/hosts", 200), ("DELETE", "/api/v1/runs/1/pin", 404)]
    {
        let answer_to = |host: &str| {
            answer(
                &deployment,
                &format!(
                    "{method} {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nConnection: close\r\n\r\n"
                ),
            )
        };
        assert!(
            answer_to("evil.example").starts_with("HTTP/1.1 421 "),
            "{method} {path}: {}",
            answer_to("evil.example")
        );
        let own_host = answer_to(&format!("127.0.0.1:{}", deployment.http_port));
        assert!(own_host.starts_with(&format!("HTTP/1.1 {status} ")), "{method} {path}: {own_host}");
    }
    let foreign_origin = "PUT /api/v1/runs/1/pin HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\nConnection: close\r\n\r\n";
    assert!(
        answer(&deployment, foreign_origin).starts_with("HTTP/1.1 403 "),
        "{}",
        answer(&deployment, foreign_origin)
    );
}

#[test]
fn request_without_exactly_one_host_is_refused() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, _) = deployment.start_aggregator();
    let answer_to = |hosts: &str| {
        answer(&deployment, &format!("GET /healthz HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n"))
    };
    assert!(answer_to("Host: localhost\r\n").starts_with("HTTP/1.1 200 "));
    for hosts in ["", "Host: localhost\r\nHost: localhost\r\n", "Host: a b\r\n"] {
        assert!(answer_to(hosts).starts_with("HTTP/1.1 400 "), "{hosts:?}: {}", answer_to(hosts));
    }
}

#[test]
fn headers_beyond_64_kib_are_refused() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, _) = deployment.start_aggregator();
    let answer_to = |target: usize, header: usize| {
        let (target, header) = ("x".repeat(target), "y".repeat(header));
        answer(
            &deployment,
            &format!(
                "GET /healthz?{target} HTTP/1.1\r\nHost: localhost\r\nX-Long: {header}\r\nConnection: close\r\n\r\n"
            ),
        )
    };
    assert!(answer_to(1, 60_000).starts_with("HTTP/1.1 200 "));
    for (target, header) in [(1, 66_000), (1, 100_000), (40_000, 40_000), (1, 10_000_000)] {
        assert!(
            answer_to(target, header).starts_with("HTTP/1.1 431 "),
            "{target} {header}: {}",
            answer_to(target, header)
        );
    }
    // Such a long target is refused as a long URI (414) or as long headers (431).
    assert!(answer_to(100_000, 1).starts_with("HTTP/1.1 4"), "{}", answer_to(100_000, 1));
    // hyper also limits the number of headers, to 100.
    let headers = "X: y\r\n".repeat(500);
    let request = format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\n{headers}Connection: close\r\n\r\n");
    assert!(answer(&deployment, &request).starts_with("HTTP/1.1 431 "), "{}", answer(&deployment, &request));
}

#[test]
fn repeated_http_failures_are_logged_at_limited_rate() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let database = deployment.folder().join("aggregator.sqlite");
    std::fs::rename(&database, deployment.folder().join("away.sqlite")).expect("moves");
    // The connections to the database are closed shortly after `/readyz` reports the missing file.
    for path in ["/readyz", "/api/v1/runs"] {
        wait_until(path, || api.get(path).filter(|(status, _)| *status == 503));
    }
    for _ in 0..20 {
        for path in ["/readyz", "/api/v1/runs"] {
            assert_eq!(api.get(path).map(|(status, _)| status), Some(503), "{path}");
        }
    }
    let log = aggregator.stop().log;
    // tower-http's own line for each failure is switched off, because it has no limit.
    assert!(!log.contains("response failed"), "{log}");
    // One line a minute for each kind of failure. An answer of `/readyz` is not logged.
    let lines = log.matches("a query of the store was not answered").count();
    assert!((1..5).contains(&lines), "{lines} lines: {log}");
}
