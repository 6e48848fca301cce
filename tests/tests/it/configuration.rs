//! Tests of `peernetd check` and of start errors: problem, place and remedy, with documented exit codes.

use std::net::TcpListener;

use peernet_tests::{LoopbackDeployment, program, root};

const USAGE: i32 = 64;
const CONFIGURATION: i32 = 78;

/// Checks a file; returns the exit code and the output.
fn check(deployment: &LoopbackDeployment, text: &str) -> (i32, String) {
    deployment.write("it.toml", text);
    let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
    (end.code(), end.log)
}

#[test]
fn unknown_key_error_names_line_and_known_keys() {
    let (code, output) =
        check(&LoopbackDeployment::new(), "[agent]\nname = \"edge\"\nagregator = \"tcp://127.0.0.1:1\"\n");
    assert_eq!(code, CONFIGURATION, "{output}");
    for part in ["it.toml:3", "agregator", "aggregator"] {
        assert!(output.contains(part), "{part} is missing in:\n{output}");
    }
}

#[test]
fn all_problems_are_reported_with_their_lines() {
    let deployment = LoopbackDeployment::new();
    std::fs::create_dir(deployment.folder().join("empty")).expect("the temporary folder is writable");
    let (code, output) = check(
        &deployment,
        r#"
[agent]
name = "edge"
state_dir = "{folder}/edge"

[[pipeline]]
name = "one"
sensor = { kind = "images", path = "{folder}/empty" }
placement = { kind = "local", model = "classifier" }

[[pipeline]]
name = "one"
sensor = { kind = "synthetic", size_bytes = 10 }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", network = "zmq-tcp", model = "echo" }
"#,
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    for part in [
        "it.toml:8: pipeline[0].sensor",
        "it.toml:9: pipeline[0].placement.model",
        "it.toml:12: pipeline[1].name",
    ] {
        assert!(output.contains(part), "{part} is missing in:\n{output}");
    }
}

#[test]
fn invalid_value_is_named_with_its_key() {
    let (code, output) =
        check(&LoopbackDeployment::new(), "[agent]\nname = \"edge\"\naggregator = \"somewhere\"\n");
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("it.toml:3: agent.aggregator: \"somewhere\""), "{output}");
}

#[test]
fn missing_or_empty_configuration_is_refused() {
    let deployment = LoopbackDeployment::new();
    let (code, output) = check(&deployment, "[log]\nlevel = \"info\"\n");
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("[agent]") && output.contains("[aggregator]"), "{output}");

    let end = deployment.peernetd(&["check", "nowhere.toml"]).wait_for_end();
    assert_eq!(end.code(), CONFIGURATION, "{}", end.log);
    assert!(end.log.contains("nowhere.toml"), "{}", end.log);
}

#[test]
fn unknown_subcommand_is_a_usage_error() {
    let end = LoopbackDeployment::new().peernetd(&["chekc", "it.toml"]).wait_for_end();
    assert_eq!(end.code(), USAGE, "{}", end.log);
}

#[test]
fn used_port_is_named_at_start() {
    let deployment = LoopbackDeployment::new();
    let listener =
        TcpListener::bind(("127.0.0.1", deployment.events_port)).expect("the port was free a moment ago");
    deployment.write(
        "it.toml",
        "[aggregator]\nlisten = \"tcp://127.0.0.1:{events}\"\ndatabase = \"{folder}/a.sqlite\"\n",
    );
    let end = deployment.start("it.toml").wait_for_end();
    assert_ne!(end.code(), 0);
    assert!(end.log.contains(&format!("127.0.0.1:{}", deployment.events_port)), "{}", end.log);
    drop(listener);
}

#[test]
fn unwritable_database_is_named_in_the_error() {
    let deployment = LoopbackDeployment::new();
    std::fs::write(deployment.folder().join("file"), "in the way").expect("the temporary folder is writable");
    let (code, output) = check(
        &deployment,
        "[aggregator]\nlisten = \"tcp://127.0.0.1:{events}\"\ndatabase = \"{folder}/file/a.sqlite\"\n",
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("it.toml:3: aggregator.database"), "{output}");
}

#[test]
fn listening_beyond_loopback_must_be_asked_for() {
    let deployment = LoopbackDeployment::new();
    let (code, output) = check(
        &deployment,
        "[aggregator]\nlisten = \"tcp://127.0.0.1:{events}\"\ndatabase = \"{folder}/a.sqlite\"\n\n[web]\nlisten = \"0.0.0.0:{http}\"\n",
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("web.listen") && output.contains("allow_unauthenticated"), "{output}");
}

#[test]
fn error_names_the_second_table_of_an_array() {
    let (code, output) = check(
        &LoopbackDeployment::new(),
        "[agent]\nname = \"edge\"\nstate_dir = \"{folder}/edge\"\n\n[[model]]\nname = \"a\"\nkind = \"echo\"\n\n[[model]]\nname = \"b\"\nkind = \"echo\"\nworkres = 2\n",
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("it.toml:9: model[1]") && output.contains("workres"), "{output}");
}

#[test]
fn agent_stop_timeout_must_fit_process_timeout() {
    let (code, output) = check(
        &LoopbackDeployment::new(),
        "[lifecycle]\nshutdown_deadline_s = 3\n\n[agent]\nname = \"edge\"\nstate_dir = \"{folder}/edge\"\nstop_timeout_ms = 4000\n",
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(
        output.contains("it.toml:7: agent.stop_timeout_ms") && output.contains("shutdown_deadline_s"),
        "{output}"
    );
}

#[test]
fn clock_and_probe_errors_name_their_line() {
    let (code, output) = check(
        &LoopbackDeployment::new(),
        r#"
[agent]
name = "edge"
state_dir = "{folder}/edge"

[clock]
max_drift_ppm = -50

[probes]
rate_hz = 0
key_file = "{folder}/no-key"

[clock_fault]
offset_ms = 1000
steps = [{ at_s = 20, by_ms = 3000 },
    { at_s = 10, by_ms = -3000 }]
"#,
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    for part in [
        "it.toml:7: clock.max_drift_ppm",
        "it.toml:10: probes.rate_hz",
        "it.toml:11: probes.key_file",
        "it.toml:16: clock_fault.steps[1].at_s",
    ] {
        assert!(output.contains(part), "{part} is missing in:\n{output}");
    }

    let (code, output) = check(&LoopbackDeployment::new(), "[aggregator]\n[clock_fault]\noffset_ms = 1000\n");
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("[clock_fault]") && output.contains("[agent]"), "{output}");
}

#[test]
fn former_table_name_is_read_and_logged_once() {
    let deployment = LoopbackDeployment::new();
    let tables = "[agent]\nname = \"edge\"\nstate_dir = \"{folder}/edge\"\n[rehearsal]\noffset_ms = 5000\n";
    let (code, output) = check(&deployment, tables);
    assert_eq!(code, 0, "{output}");
    let line = "deprecated: it.toml:4: the table [rehearsal] is now called [clock_fault]";
    assert_eq!(output.matches(line).count(), 1, "{output}");

    let agent = deployment.peernetd(&["run", "it.toml"]);
    agent.wait_for("ready");
    let log = agent.stop().log;
    assert_eq!(log.matches(line).count(), 1, "{log}");
    assert!(log.contains("CLOCK FAULT INJECTION") && log.contains("offset +5000 ms"), "{log}");

    let (code, output) = check(&deployment, "[agent]\n[rehearsal]\n[clock_fault]\n");
    assert!(code == CONFIGURATION && output.contains("duplicate field `clock_fault`"), "{output}");
}

#[test]
fn invalid_log_level_and_endless_file_are_refused() {
    let deployment = LoopbackDeployment::new();
    let (code, output) = check(
        &deployment,
        "[log]\nlevel = \"loud=very\"\n[agent]\nname = \"edge\"\nstate_dir = \"{folder}/edge\"\n",
    );
    assert_eq!(code, CONFIGURATION, "{output}");
    assert!(output.contains("it.toml:2: log.level"), "{output}");

    let end = deployment.peernetd(&["check", "/dev/zero"]).wait_for_end();
    assert_eq!(end.code(), CONFIGURATION, "{}", end.log);
    assert!(end.log.contains("right file"), "{}", end.log);
}

/// The telemetry of ONNX Runtime would write an identifier to the home folder, and send data to its developers.
#[test]
fn loaded_model_library_leaves_home_empty() {
    let home = tempfile::tempdir().expect("writable");
    let mut check = std::process::Command::new(program("peernetd"));
    // Each of the first three variables switches the telemetry off; continuous integration sets the
    // second and the third. The last variable would move the library's files out of the home
    // folder.
    check.args(["check", "configs/cloud.toml"]).current_dir(root()).env("HOME", home.path());
    for variable in ["ORT_DISABLE_TELEMETRY", "CI", "GITHUB_ACTIONS", "XDG_CACHE_HOME"] {
        check.env_remove(variable);
    }
    assert!(check.status().expect("it was built").success());
    assert_eq!(std::fs::read_dir(home.path()).expect("it is ours").count(), 0);
}
