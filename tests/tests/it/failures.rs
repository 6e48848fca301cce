//! Tests of failures between real processes.

use peernet_tests::{Api, LoopbackDeployment, Process, StoredEvents};
use serde_json::Value;

const CLOUD: &str = r#"
[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "echo"
kind = "echo"

[[model]]
name = "slow"
kind = "sleep"
preprocessing_ms = 0
inference_ms = 40
postprocessing_ms = 0
"#;

fn start_edge(deployment: &LoopbackDeployment, name: &str, model: &str) -> Process {
    deployment.start_agent(name, &EDGE.replace("MODEL", model))
}

const EDGE: &str = r#"
[[pipeline]]
name = "loop"
sensor = { kind = "synthetic", size_bytes = 1000 }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "MODEL" }
load = { mode = "rate", hz = 50.0 }
"#;

fn start_cloud(deployment: &LoopbackDeployment) -> Process {
    deployment.start_agent("cloud", CLOUD)
}

/// Returns the iterations of a host's newest run by outcome.
fn counts(api: &Api, host: &str) -> Option<Value> {
    let runs = api.json("/api/v1/runs");
    runs["runs"].as_array()?.iter().find(|run| run["host"] == host).map(|run| run["counts"].clone())
}

fn count(api: &Api, host: &str, outcome: &str) -> u64 {
    counts(api, host).and_then(|counts| counts[outcome].as_u64()).unwrap_or_default()
}

#[test]
fn pipeline_survives_late_and_restarted_cloud() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let edge = start_edge(&deployment, "edge", "slow");
    let output = edge.wait_for("cannot reach a cloud");
    assert!(output.contains("continues automatically"), "{output}");

    let first = start_cloud(&deployment);
    peernet_tests::wait_until("answers", || (count(&api, "edge", "ok") > 20).then_some(()));
    assert_eq!(
        edge.log().matches("cannot reach a cloud").count(),
        1,
        "the message is logged once:\n{}",
        edge.log()
    );

    first.kill();
    peernet_tests::wait_until("lost iterations", || (count(&api, "edge", "lost") > 0).then_some(()));
    let answered = count(&api, "edge", "ok");
    let second = start_cloud(&deployment);
    peernet_tests::wait_until("answers again", || (count(&api, "edge", "ok") > answered + 20).then_some(()));

    let runs = api.json("/api/v1/runs");
    assert_eq!(runs["runs"].as_array().map(Vec::len), Some(1), "the same run continues: {runs}");
    let unsuccessful = api.json("/api/v1/runs/1/iterations?unsuccessful=true&limit=1000");
    let iterations = unsuccessful["iterations"].as_array().expect("a list");
    let lost: Vec<&Value> = iterations.iter().filter(|iteration| iteration["outcome"] == "lost").collect();
    // At most four iterations are in flight, one waits to be sent, and one waits for its sample.
    assert!(
        (1..=6).contains(&lost.len()),
        "only iterations at the time of the kill are lost: {unsuccessful}"
    );
    for iteration in lost {
        let reason = iteration["reason"].as_str().expect("a lost iteration has a reason");
        assert!(reason.contains("connection"), "the reason does not name the connection: {reason}");
    }
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(second.stop().code(), 0);
}

#[test]
fn unknown_model_error_lists_models() {
    let deployment = LoopbackDeployment::new();
    let cloud = start_cloud(&deployment);
    cloud.wait_for("ready");
    let edge = start_edge(&deployment, "edge", "classifier");
    let output = edge.wait_for("refused the session");
    for model in ["classifier", "echo", "slow"] {
        assert!(output.contains(model), "the error does not name {model}: {output}");
    }
    assert_eq!(edge.stop().code(), 0);
}

#[test]
fn agents_deliver_to_late_aggregator() {
    let deployment = LoopbackDeployment::new();
    let cloud = start_cloud(&deployment);
    let edge = start_edge(&deployment, "edge", "echo");
    edge.wait_for("connected to cloud");
    edge.wait_for("no connection to the aggregator");
    let (aggregator, api) = deployment.start_aggregator();
    peernet_tests::wait_until("stored iterations", || (count(&api, "edge", "ok") > 100).then_some(()));

    // The aggregator is killed and started again with the same database. No iteration is stored twice or missing.
    aggregator.kill();
    let (aggregator, api) = deployment.start_aggregator();
    let before = count(&api, "edge", "ok");
    peernet_tests::wait_until("more iterations", || (count(&api, "edge", "ok") > before + 100).then_some(()));
    for process in [edge, cloud, aggregator] {
        assert_eq!(process.stop().code(), 0);
    }
    let stored_events = StoredEvents::read(&deployment.folder().join("aggregator.sqlite"));
    stored_events.assert_consistent();
    let runs: Vec<_> = stored_events.runs.values().collect();
    let [run] = runs.as_slice() else { panic!("the same run continues: {stored_events:?}") };
    assert!(run.is_contiguous() && run.iterations() > before + 100, "iterations are missing: {run:?}");
    assert_eq!((run.missing, run.reason.as_str()), (0, "stopped"), "{run:?}");
}

#[test]
fn duplicate_host_name_and_crashed_host_are_reported() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let cloud = start_cloud(&deployment);
    let first = start_edge(&deployment, "edge", "echo");
    peernet_tests::wait_until("stored iterations", || (count(&api, "edge", "ok") > 0).then_some(()));

    // The same file with another folder for its state.
    let file = std::fs::read_to_string(deployment.folder().join("edge.toml")).expect("it was written");
    let state = deployment.folder().display().to_string();
    deployment.write("impostor.toml", &file.replace(&format!("{state}/edge"), &format!("{state}/impostor")));
    let impostor = deployment.start("impostor.toml");
    let output = impostor.wait_for("the aggregator refuses this agent");
    assert!(output.contains("the name edge is taken"), "{output}");
    assert_eq!(impostor.stop().code(), 0);

    first.kill();
    let second = start_edge(&deployment, "edge", "echo");
    let first_run = api.wait_until("/api/v1/runs", |runs| {
        // The newest run is the first of the list.
        let [_, first_run] = runs["runs"].as_array()?.as_slice() else { return None };
        Some(first_run.clone())
    });
    assert_eq!(first_run["reason"], "the agent ended without saying so", "{first_run}");
    assert_eq!(second.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn broken_picture_gives_one_failed_iteration() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let pictures = deployment.folder().join("pictures");
    std::fs::create_dir(&pictures).expect("the temporary folder is writable");
    let picture = peernet_tests::root().join("models/quality-control/pictures/part-0001.jpg");
    std::fs::copy(&picture, pictures.join("1.jpg")).expect("the demo's pictures are there");
    std::fs::write(pictures.join("2.jpg"), b"this is not a picture")
        .expect("the temporary folder is writable");
    std::fs::copy(&picture, pictures.join("3.jpg")).expect("the demo's pictures are there");
    let edge = deployment.start_agent(
        "edge",
        r#"
[[model]]
name = "quality-control"
kind = "onnx"
path = "{root}/models/quality-control"

[[pipeline]]
name = "local"
sensor = { kind = "images", path = "{folder}/pictures", repeat = false }
placement = { kind = "local", model = "quality-control" }
warm_up = { iterations = 0 }
"#,
    );
    let run = api.wait_for_finished_run();
    let counts = api.json(&format!("/api/v1/runs/{run}"))["counts"].clone();
    assert_eq!((counts["ok"].as_u64(), counts["failed"].as_u64()), (Some(2), Some(1)), "{counts}");
    let failed = api.json(&format!("/api/v1/runs/{run}/iterations?unsuccessful=true"));
    assert!(
        failed["iterations"][0]["reason"].as_str().is_some_and(|reason| reason.contains("2.jpg")),
        "{failed}"
    );
    assert_eq!(edge.stop().code(), 0);
}
