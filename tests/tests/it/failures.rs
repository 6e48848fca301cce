//! Tests of failures between real processes.

use peernet_tests::{Api, LoopbackDeployment, Process};
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
    let lost = peernet_tests::wait_until("lost iterations", || {
        Some(count(&api, "edge", "lost")).filter(|count| *count > 0)
    });
    let answered = count(&api, "edge", "ok");
    let second = start_cloud(&deployment);
    peernet_tests::wait_until("answers again", || (count(&api, "edge", "ok") > answered + 20).then_some(()));

    let runs = api.json("/api/v1/runs");
    assert_eq!(runs["runs"].as_array().map(Vec::len), Some(1), "the same run continues: {runs}");
    let unsuccessful = api.json("/api/v1/runs/1/iterations?unsuccessful=true");
    let reason = unsuccessful["iterations"][0]["reason"].as_str().unwrap_or_default();
    assert!(!reason.is_empty(), "a lost iteration has no reason: {unsuccessful}");
    assert!(lost > 0);
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(second.stop().code(), 0);
}

#[test]
fn unknown_model_error_lists_models() {
    let deployment = LoopbackDeployment::new();
    let cloud = start_cloud(&deployment);
    cloud.wait_for("ready");
    let edge = start_edge(&deployment, "edge", "classifier");
    let output = edge.wait_for("classifier");
    // The error need not be the first line that names the unknown model.
    let output = if output.contains("echo") { output } else { edge.wait_for("echo") };
    assert!(output.contains("echo") && output.contains("slow"), "{output}");
    assert_eq!(edge.stop().code(), 0);
}

#[test]
fn agents_deliver_to_late_aggregator() {
    let deployment = LoopbackDeployment::new();
    let cloud = start_cloud(&deployment);
    let edge = start_edge(&deployment, "edge", "echo");
    edge.wait_for("connected to cloud");
    // The edge reports that it has no connection to the aggregator.
    edge.wait_for("aggregator");
    let (aggregator, api) = deployment.start_aggregator();
    peernet_tests::wait_until("stored iterations", || (count(&api, "edge", "ok") > 100).then_some(()));

    // The aggregator is killed and started again with the same database. No iteration is stored twice or missing.
    aggregator.kill();
    let (_aggregator, api) = deployment.start_aggregator();
    let before = count(&api, "edge", "ok");
    peernet_tests::wait_until("more iterations", || (count(&api, "edge", "ok") > before + 100).then_some(()));
    assert_eq!(edge.stop().code(), 0);
    let iterations = api.json("/api/v1/runs/1/iterations?limit=100");
    let numbers: Vec<u64> = iterations["iterations"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|iteration| iteration["number"].as_u64())
        .collect();
    assert_eq!(numbers, (1..=100).collect::<Vec<u64>>());
    let detail = api.json("/api/v1/runs/1");
    assert_eq!(detail["reason"], "stopped", "{detail}");
    assert_eq!(cloud.stop().code(), 0);
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
    let output = impostor.wait_for("refused");
    assert!(output.contains("edge"), "{output}");
    assert_eq!(impostor.stop().code(), 0);

    first.kill();
    let second = start_edge(&deployment, "edge", "echo");
    peernet_tests::wait_until("the second run", || {
        let runs = api.json("/api/v1/runs");
        (runs["runs"].as_array()?.len() == 2).then_some(())
    });
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
