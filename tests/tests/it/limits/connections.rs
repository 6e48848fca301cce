//! Tests of connections without a hello.

use std::path::Path;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::{AGGREGATOR, Api, LoopbackDeployment, Process, program, wait_until};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::Peer;

/// Number of connections: more than the daemon's limit of descriptors.
const SILENT_CONNECTIONS: usize = 1_030;

#[test]
fn silent_connections_stop_neither_storing_nor_dashboard() {
    // This process has the other end of each connection, so it needs as many descriptors.
    let maximum = getrlimit(Resource::Nofile).maximum;
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).expect("the soft limit may be raised");
    let deployment = LoopbackDeployment::new();
    // With this long timeout, silent connections stay open.
    deployment.write("aggregator.toml", &AGGREGATOR.replace("[web]", "hello_timeout_ms = 60000\n[web]"));
    let peernetd = program("peernetd").display().to_string();
    let arguments = ["--nofile=1024:1024", &peernetd, "run", "aggregator.toml"];
    let aggregator = Process::start(Path::new("prlimit"), &arguments, deployment.folder(), &[]);
    let api = Api::on_port(deployment.http_port);
    wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
    let agent = |name: &str| {
        deployment.write(
            &format!("{name}.toml"),
            &agent_configuration("", &echo_pipeline("loop", &rate_load(50.0))).replace("NAME", name),
        );
        deployment.start(&format!("{name}.toml"))
    };
    let early = agent("early");
    let stored_events = |name: &str| {
        let (_, text) = api.get("/metrics").filter(|(status, _)| *status == 200)?;
        let metric = format!("peernet_host_stored_events_total{{host=\"{name}\"}} ");
        text.lines().find_map(|line| line.strip_prefix(&metric)?.parse::<f64>().ok())
    };
    let wait_for_more = |name: &str, minimum: f64| {
        wait_until("more is stored", || stored_events(name).filter(|count| *count > minimum))
    };
    wait_for_more("early", 0.0);

    // Half of the peers complete the handshake of the protocol and send nothing more.
    let open_silent_connection = |number: usize| {
        if number.is_multiple_of(2) {
            Peer::connect(deployment.events_port)
        } else {
            Peer::connect_with_handshake(deployment.events_port)
        }
    };
    let connections: Vec<Peer> = (0..SILENT_CONNECTIONS).map(open_silent_connection).collect();
    let before = wait_for_more("early", 0.0);
    wait_for_more("early", before + 50.0);
    // A new agent still gets a connection, and the store can open its files.
    let late = agent("late");
    wait_for_more("late", 50.0);
    assert_eq!(api.json("/api/v1/runs")["runs"].as_array().map(Vec::len), Some(2));
    let descriptors = std::fs::read_dir(format!("/proc/{}/fd", aggregator.pid())).expect("it runs").count();
    // A quarter of the 1,024 descriptors must stay free.
    assert!(descriptors < 768, "{descriptors} descriptors");
    drop(connections);
    for process in [early, late, aggregator] {
        assert_eq!(process.stop().code(), 0);
    }
}

#[test]
fn connections_without_hello_are_closed_in_time() {
    let deployment = LoopbackDeployment::new();
    deployment.write("aggregator.toml", &AGGREGATOR.replace("[web]", "hello_timeout_ms = 200\n[web]"));
    let tables = "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\nsession = { hello_timeout_ms = 200 }\n\
                  [[model]]\nname = \"echo\"\nkind = \"echo\"\n";
    let aggregator = deployment.start("aggregator.toml");
    let cloud = deployment.start_agent("cloud", tables);
    aggregator.wait_for("ready");
    cloud.wait_for("ready");
    let mut connections: Vec<Peer> = [deployment.events_port, deployment.data_port]
        .iter()
        .flat_map(|port| (0..50).map(|_| Peer::connect_with_handshake(*port)))
        .collect();
    wait_until("all are closed", || connections.iter_mut().all(Peer::is_closed).then_some(()));
    for process in [cloud, aggregator] {
        let end = process.stop();
        assert_eq!(end.code(), 0);
        // The first rejection is logged at once. Later rejections are logged once a minute, as a count.
        assert_eq!(end.log.matches("no_hello").count(), 1, "{}", end.log);
    }
}
