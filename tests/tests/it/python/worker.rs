//! Tests of the worker process and its agent.

use std::fs;
use std::path::PathBuf;

use peernet_tests::{LoopbackDeployment, Process, wait_until};

use super::{model_table, pipeline_table, write_modules};

/// Exit code for an invalid configuration.
const EXIT_CONFIGURATION: i32 = 78;

/// Creates a deployment with both modules in its folder; `follower` replaces the module of the model.
fn create_deployment(follower: Option<&str>) -> LoopbackDeployment {
    let deployment = LoopbackDeployment::new();
    write_modules(deployment.folder());
    if let Some(text) = follower {
        fs::write(deployment.folder().join("follower.py"), text).expect("the temporary folder is writable");
    }
    deployment
}

/// Starts an agent that serves the model, and one that uses it, with additional keys of its pipeline.
fn start(deployment: &LoopbackDeployment, keys: &str) -> (Process, Process) {
    let serve = "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\n";
    let cloud = deployment.start_agent("cloud", &(serve.to_owned() + &model_table()));
    let pipeline =
        pipeline_table("{ kind = \"remote\", peer = \"tcp://127.0.0.1:{data}\", model = \"follower\" }");
    (cloud, deployment.start_agent("edge", &(pipeline + keys)))
}

/// Returns the folder of the model's process in `/proc`, once the process exists.
fn wait_for_worker(deployment: &LoopbackDeployment) -> PathBuf {
    let pid = wait_until("the process of the model", || {
        let text = fs::read_to_string(deployment.folder().join("pid")).ok()?;
        (!text.is_empty()).then_some(text)
    });
    PathBuf::from("/proc").join(pid)
}

#[test]
fn killed_agent_leaves_no_python_process() {
    let deployment = create_deployment(None);
    let (cloud, _edge) = start(&deployment, "");
    let worker = wait_for_worker(&deployment);
    assert!(worker.exists());
    cloud.kill();
    wait_until("the worker is gone", || (!worker.exists()).then_some(()));
}

#[test]
fn check_names_missing_module_without_running_code() {
    let deployment = create_deployment(None);
    let invalid_model = model_table().replace("follower::Follower", "folower::Follower");
    let pipeline = pipeline_table("{ kind = \"local\", model = \"follower\" }");
    deployment
        .write("it.toml", &format!("[agent]\nstate_dir = \"{{folder}}/it\"\n{invalid_model}{pipeline}"));
    let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
    assert_eq!(end.code(), EXIT_CONFIGURATION, "{}", end.log);
    assert!(end.log.contains("model[0]") && end.log.contains("no Python module folower"), "{}", end.log);
    assert!(!end.log.contains("the rig is up"), "{}", end.log);
    assert!(!deployment.folder().join("pid").exists(), "an object was created");
}

#[test]
fn dead_model_process_is_restarted() {
    let deployment = create_deployment(Some(
        "
import os
class Follower:
    def infer(self, sample):
        if sample[1][0] == 5:
            os._exit(9)
        return 0
",
    ));
    let (_aggregator, api) = deployment.start_aggregator();
    let (cloud, edge) = start(&deployment, "limit = { total = 12 }\n");
    let run = api.wait_for_finished_run();
    // Only the call in which the process died has no answer.
    let counts = api.json(&format!("/api/v1/runs/{run}"))["counts"].clone();
    assert_eq!((counts["ok"].as_u64(), counts["failed"].as_u64()), (Some(11), Some(1)), "{counts}");
    cloud.wait_for("restarting a Python process");
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn hanging_model_delays_neither_iterations_nor_stop() {
    let deployment = create_deployment(Some(
        "
import os, time
open('pid', 'w').write(str(os.getpid()))
class Follower:
    def infer(self, sample):
        print('hanging')
        time.sleep(600)
",
    ));
    let (_aggregator, api) = deployment.start_aggregator();
    let (cloud, edge) = start(&deployment, "timeout_ms = 300\n");
    cloud.wait_for("hanging");
    let worker = wait_for_worker(&deployment);
    api.wait_until("/api/v1/runs", |runs| {
        (runs["runs"][0]["counts"]["timeout"].as_u64() > Some(2)).then_some(())
    });
    edge.stop();
    cloud.stop();
    wait_until("the worker is gone", || (!worker.exists()).then_some(()));
}
