//! Tests of start, readiness, watchdog, stop and exit codes, as systemd sees them.

use std::os::unix::net::UnixDatagram;
use std::path::Path;

use peernet_tests::{LoopbackDeployment, Process, TEST_TIMEOUT, program, wait_until};
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
struct ServiceManager {
    socket: UnixDatagram,
    path: String,
}

impl ServiceManager {
    fn new(deployment: &LoopbackDeployment) -> Self {
        let path = deployment.folder().join("notify.sock");
        let socket = UnixDatagram::bind(&path).expect("the temporary folder is writable");
        socket.set_read_timeout(Some(TEST_TIMEOUT)).expect("a timeout can be set");
        Self { socket, path: path.display().to_string() }
    }

    fn receive(&self) -> String {
        let mut message = [0; 4096];
        let length = self.socket.recv(&mut message).expect("the daemon notifies the service manager");
        String::from_utf8_lossy(&message[..length]).into_owned()
    }

    fn wait_for(&self, state: &str) {
        while !self.receive().lines().any(|line| line == state) {}
    }
}

#[test]
fn service_manager_receives_ready_watchdog_and_stopping() {
    let deployment = LoopbackDeployment::new();
    let manager = ServiceManager::new(&deployment);
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
fn ctrl_c_and_closed_terminal_stop_daemon() {
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
    // systemd sets the variable to the device and inode of the journal's socket, which is then standard error.
    let script = "exec env JOURNAL_STREAM=$(stat -L -c %d:%i /proc/self/fd/2) \"$0\" run edge.toml";
    let daemon_path = program("peernetd").display().to_string();
    let daemon = Process::start(Path::new("sh"), &["-c", script, &daemon_path], deployment.folder(), &[]);
    let line = daemon.wait_for("ready");
    // 6 is the priority of informational lines.
    assert!(line.starts_with("<6>"), "{line}");
    assert_eq!(daemon.stop().code(), 0);
}

#[test]
fn inherited_variable_of_journald_is_ignored() {
    let deployment = LoopbackDeployment::new();
    deployment.write("edge.toml", AGENT);
    let daemon = deployment.start_with("edge.toml", &[("JOURNAL_STREAM", "8:1")]);
    let line = daemon.wait_for("ready");
    assert!(line.starts_with("20"), "the line begins with the time: {line}");
    assert_eq!(daemon.stop().code(), 0);
}

#[test]
fn empty_log_variable_counts_as_not_set() {
    let deployment = LoopbackDeployment::new();
    deployment.write("edge.toml", AGENT);
    let daemon = deployment.start_with("edge.toml", &[("PEERNET_LOG", "")]);
    // This line has the level `info`, the default.
    daemon.wait_for("ready");
    assert_eq!(daemon.stop().code(), 0);
}

#[test]
fn second_signal_ends_daemon_immediately() {
    // After the first signal, the daemon waits several seconds for the model, which computes for ten minutes.
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

/// Script that writes a model of 100,000 additions into a folder. ONNX Runtime takes half a minute to open the model,
/// in a call that cannot be terminated.
const LONG_CHAIN: &str = r#"
import sys
import numpy, onnx
from onnx import helper, numpy_helper
nodes = [helper.make_node("Add", [f"v{n}", "one"], [f"v{n + 1}"]) for n in range(100000)]
value = lambda name: helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1])
one = numpy_helper.from_array(numpy.ones(1, numpy.float32), "one")
graph = helper.make_graph(nodes, "chain", [value("v0")], [value("v100000")], [one])
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
onnx.save_model(model, sys.argv[1] + "/model.onnx")
tensor = 'dtype = "float32"\nshape = [1]\n'
card = f'name = "chain"\ntask = "tensors"\n[input]\nname = "v0"\n{tensor}[output]\nname = "v100000"\n{tensor}'
open(sys.argv[1] + "/model.toml", "w").write(card)
"#;

#[test]
fn stop_while_a_model_opens_is_clean() {
    let deployment = LoopbackDeployment::new();
    let [model, temporary] = ["chain", "tmp"].map(|name| deployment.folder().join(name));
    for folder in [&model, &temporary] {
        std::fs::create_dir(folder).expect("a folder");
    }
    // By default the system's interpreter, because others do not find Debian's packages.
    let python = std::env::var_os("PEERNET_PYTHON").unwrap_or_else(|| "/usr/bin/python3".into());
    let written = std::process::Command::new(python).args(["-c", LONG_CHAIN]).arg(&model).status();
    assert!(written.expect("Python is installed").success());
    let library = peernet_tests::onnxruntime().join("libonnxruntime.so");
    // Two workers share the weights in a temporary folder. When this folder exists, the model is being opened.
    let table =
        format!("kind = \"onnx\"\npath = \"chain\"\nworkers = 2\n[onnxruntime]\nlibrary = {library:?}");
    let slow = AGENT.replace("kind = \"echo\"", &table);
    deployment.write("edge.toml", &slow.replace("[agent]", "[agent]\nstop_timeout_ms = 100"));
    let tmpdir = temporary.display().to_string();
    let environment = [("TMPDIR", tmpdir.as_str())];
    let daemon =
        Process::start(&program("peernetd"), &["run", "edge.toml"], deployment.folder(), &environment);
    let is_empty = || std::fs::read_dir(&temporary).is_ok_and(|mut entries| entries.next().is_none());
    wait_until("the opening of the model", || (!is_empty()).then_some(()));
    daemon.terminate();
    let end = daemon.wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let line = end.log.lines().find(|line| line.contains("its thread was abandoned")).expect("a warning");
    assert!(line.contains("model=echo"), "{line}");
    assert!(is_empty(), "the temporary folder of the weights remains");
}

#[test]
fn version_contains_the_commit() {
    let deployment = LoopbackDeployment::new();
    let end = deployment.peernetd(&["--version"]).wait_for_end();
    assert_eq!(end.code(), 0);
    let words: Vec<&str> = end.log.split_whitespace().collect();
    assert_eq!(words[0], "peernetd");
    assert_eq!(words[1], env!("CARGO_PKG_VERSION"));
    // The third word is the commit in parentheses.
    assert!(words[2].starts_with('('), "{}", end.log);
}
