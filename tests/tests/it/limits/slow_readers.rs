//! Test of hosts that request pages of the dashboard and do not read the answers.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;

use peernet_tests::{AGGREGATOR, Api, LoopbackDeployment, Process, TEST_TIMEOUT, program, wait_until};
use socket2::{Domain, Socket, Type};

/// Limit of the daemon's descriptors. Under this limit the dashboard keeps 110 connections
/// (docs/operating.md, limits before authentication).
const DESCRIPTORS: &str = "--nofile=1024:1024";

/// Number of slow hosts. Together they open more connections than the 110 that the dashboard keeps.
/// Each of them opens less than a quarter of these 110, so that no single host has most of them.
const SLOW_HOSTS: u8 = 6;
const CONNECTIONS_PER_HOST: usize = 25;

/// Returns a connection of 127.0.0.`host` that has requested `path` and reads almost nothing.
fn send_request(deployment: &LoopbackDeployment, host: u8, path: &str) -> TcpStream {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None).expect("a socket");
    socket.set_recv_buffer_size(2_048).expect("a socket takes a buffer size");
    socket
        .bind(&SocketAddr::from(([127, 0, 0, host], 0)).into())
        .expect("all of 127.0.0.0/8 is this machine");
    socket
        .connect(&SocketAddr::from(([127, 0, 0, 1], deployment.http_port)).into())
        .expect("the port is open");
    let mut stream = TcpStream::from(socket);
    stream.set_read_timeout(Some(TEST_TIMEOUT)).expect("a socket takes a timeout");
    let request = format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    // The connection may have been closed in favour of another host's.
    let _closed = stream.write_all(request.as_bytes());
    stream
}

#[test]
fn slow_readers_do_not_block_dashboard() {
    let deployment = LoopbackDeployment::new();
    deployment.write("aggregator.toml", AGGREGATOR);
    let peernetd = program("peernetd").display().to_string();
    let arguments = [DESCRIPTORS, &peernetd, "run", "aggregator.toml"];
    let aggregator = Process::start(Path::new("prlimit"), &arguments, deployment.folder(), &[]);
    let api = Api::on_port(deployment.http_port);
    wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));

    for path in ["/api/v1/live?topics=picture", "/api/openapi.json"] {
        let hosts = 2..2 + SLOW_HOSTS;
        let slow_readers: Vec<TcpStream> = hosts
            .flat_map(|host| (0..CONNECTIONS_PER_HOST).map(move |_| host))
            .map(|host| send_request(&deployment, host, path))
            .collect();
        let (status, page) = api.get("/").expect("the overview is served");
        assert_eq!(status, 200, "{page}");
        let mut live = send_request(&deployment, 1, "/api/v1/live?topics=picture");
        let mut buffer = [0; 4_096];
        let length = live.read(&mut buffer).expect("the stream begins");
        let answer = String::from_utf8_lossy(&buffer[..length]);
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        drop(slow_readers);
    }
    let end = aggregator.stop();
    assert_eq!(end.code(), 0);
    // The first refusal is logged at once. Later refusals are logged once a minute, as a count.
    assert_eq!(end.log.matches("closed a new connection").count(), 1, "{}", end.log);
}
