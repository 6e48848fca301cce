//! Tests of the permissions of PEERNet's files.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use peernet_tests::{Api, LoopbackDeployment, Process};

const PIPELINE: &str = r#"
[[pipeline]]
name = "line"
sensor = { kind = "synthetic", size_bytes = 10 }
placement = { kind = "none" }
load = { mode = "rate", hz = 20.0 }
"#;

/// Returns the files of the daemons: databases, spools, ids, locks, and the folders that they created.
fn state_files(deployment: &LoopbackDeployment) -> Vec<PathBuf> {
    let entries = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).expect("the folder exists");
        entries.map(|entry| entry.expect("is readable").path()).collect()
    };
    let is_configuration = |path: &Path| path.extension().is_some_and(|extension| extension == "toml");
    let mut files = Vec::new();
    for path in entries(deployment.folder()).into_iter().filter(|path| !is_configuration(path)) {
        if path.is_dir() {
            files.extend(entries(&path));
        }
        files.push(path);
    }
    files
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).expect("the file exists").permissions().mode() & 0o777
}

fn start(deployment: &LoopbackDeployment) -> (Process, Process, Api) {
    let (aggregator, api) = deployment.start_aggregator();
    let edge = deployment.start_agent("edge", PIPELINE);
    api.wait_until("/api/v1/runs", |runs| {
        runs["runs"].as_array()?.iter().find(|run| run["counts"]["ok"].as_u64() > Some(10)).map(drop)
    });
    (aggregator, edge, api)
}

#[test]
fn files_of_daemons_are_closed_to_other_users() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, edge, _api) = start(&deployment);
    let files = state_files(&deployment);
    for name in
        ["aggregator.sqlite", "aggregator.sqlite-wal", "aggregator.sqlite-shm", "host-id", "spool.sqlite"]
    {
        assert!(files.iter().any(|path| path.ends_with(name)), "{name}: {files:?}");
    }
    for path in files {
        assert_eq!(mode(&path) & 0o007, 0, "{}: {:o}", path.display(), mode(&path));
    }
    let secret = deployment.folder().join("edge/argument-key");
    assert_eq!(mode(&secret), 0o600);
    let backup =
        deployment.peernetd(&["backup", "--config", "aggregator.toml", "copy.sqlite"]).wait_for_end();
    assert_eq!(backup.code(), 0, "{}", backup.log);
    let copy = deployment.folder().join("copy.sqlite");
    assert_eq!(mode(&copy) & 0o007, 0, "{:o}", mode(&copy));
    edge.stop();
    aggregator.stop();
}

#[test]
fn files_of_earlier_versions_are_restricted_at_start() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, edge, _api) = start(&deployment);
    edge.stop();
    aggregator.stop();
    let set_mode = |name: &str, mode: u32| {
        let path = deployment.folder().join(name);
        fs::set_permissions(&path, Permissions::from_mode(mode)).expect("the file belongs to this user");
        path
    };
    let expected_modes = [
        (set_mode("aggregator.sqlite", 0o644), 0o640),
        (set_mode("edge", 0o755), 0o750),
        (set_mode("edge/host-id", 0o644), 0o640),
        // The operator has granted write permission to the group.
        (set_mode("edge/spool.sqlite", 0o664), 0o660),
    ];
    let (aggregator, edge, _api) = start(&deployment);
    edge.wait_for("removed the permissions of other users");
    for (path, expected) in expected_modes {
        assert_eq!(mode(&path), expected, "{}", path.display());
    }
    for log in [edge.stop().log, aggregator.stop().log] {
        assert_eq!(log.matches("removed the permissions of other users").count(), 1, "{log}");
    }
}
