//! Tests of start, readiness, watchdog, stop and exit codes, as systemd sees them.

use std::os::unix::net::UnixDatagram;

use peernet_tests::{LoopbackDeployment, Process, TEST_TIMEOUT, program};
use rustix::process::Signal;

const AGENT: &str = r#"
[agent]
name = "edge"
state_dir = "{folder}/edge"

[[model]]
name = "echo"
kind = "echo"

[[pipeline]]
name = "loop"
sensor = { kind = "synthetic", size_bytes = 1000 }
placement = { kind = "local", model = "echo" }
load = { mode = "rate", hz = 50.0 }
"#;

/// systemd's end of the notification socket.
struct Manager {
    socket: UnixDatagram,
    path: String,
}

impl Manager {
    fn new(deployment: &LoopbackDeployment) -> Self {
        let path = deployment.folder().join("notify.sock");
        let socket = UnixDatagram::bind(&path).expect("the temporary folder is writable");
        socket.set_read_timeout(Some(TEST_TIMEOUT)).expect("a timeout can be set");
        Self { socket, path: path.display().to_string() }
    }

    fn receive(&self) -> String {
        let mut message = [0; 4096];
        let length = self.socket.recv(&mut message).expect("the daemon tells the service manager");
        String::from_utf8_lossy(&message[..length]).into_owned()
    }

    fn wait_for(&self, state: &str) {
        while !self.receive().lines().any(|line| line == state) {}
    }
}

#[test]
fn service_manager_receives_ready_watchdog_and_stopping() {
    let deployment = LoopbackDeployment::new();
    let manager = Manager::new(&deployment);
    deployment.write("edge.toml", AGENT);
    let daemon = Process::start(
        &program("peernetd"),
        &["run", "edge.toml"],
        deployment.folder(),
        &[("NOTIFY_SOCKET", &manager.path), ("WATCHDOG_USEC", "400000")],
    );
    manager.wait_for("READY=1");
    manager.wait_for("WATCHDOG=1");
    manager.wait_for("WATCHDOG=1");
    daemon.terminate();
    manager.wait_for("STOPPING=1");
    let end = daemon.wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
}

#[test]
fn ctrl_c_and_end_of_session_stop_daemon() {
    let deployment = LoopbackDeployment::new();
    deployment.write("edge.toml", AGENT);
    for (signal, name) in [(Signal::INT, "SIGINT"), (Signal::HUP, "SIGHUP")] {
        let daemon = deployment.start("edge.toml");
        daemon.wait_for("ready");
        daemon.signal(signal);
        daemon.wait_for(&format!("{name}: stopping"));
        assert_eq!(daemon.wait_for_end().code(), 0);
    }
}

#[test]
fn under_journald_lines_carry_priorities_instead_of_times() {
    let deployment = LoopbackDeployment::new();
    deployment.write("edge.toml", AGENT);
    let daemon = Process::start(
        &program("peernetd"),
        &["run", "edge.toml"],
        deployment.folder(),
        &[("JOURNAL_STREAM", "8:1")],
    );
    let line = daemon.wait_for("ready");
    assert!(line.starts_with("<6>"), "{line}");
    assert_eq!(daemon.stop().code(), 0);
}

#[test]
fn second_signal_ends_daemon_immediately() {
    // The first signal would wait for a model that computes for ten minutes.
    let deployment = LoopbackDeployment::new();
    let slow = AGENT.replace("kind = \"echo\"", "kind = \"sleep\"\ninference_ms = 600000");
    deployment.write("edge.toml", &slow.replace("[agent]", "[agent]\nstop_timeout_ms = 9000"));
    let daemon = deployment.start("edge.toml");
    daemon.wait_for("loaded echo");
    daemon.terminate();
    daemon.wait_for("SIGTERM: stopping");
    // A second SIGTERM within half a second would count as the same signal.
    daemon.signal(Signal::INT);
    daemon.wait_for("ending at once");
    assert_eq!(daemon.wait_for_end().code(), 70);
}

#[test]
fn version_contains_the_commit() {
    let deployment = LoopbackDeployment::new();
    let end = deployment.peernetd(&["--version"]).wait_for_end();
    assert_eq!(end.code(), 0);
    let words: Vec<&str> = end.log.split_whitespace().collect();
    assert_eq!(words[0], "peernetd");
    assert_eq!(words[1], env!("CARGO_PKG_VERSION"));
    assert!(words[2].starts_with('('), "{}", end.log);
}
