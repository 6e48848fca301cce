//! Tests of the whole chain from the sensor to the store and the page, over three processes, with a real model on
//! real pictures.

use peernet_tests::{LoopbackDeployment, Process, program, root};
use serde_json::Value;

const CLOUD: &str = r#"
[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "quality-control"
kind = "onnx"
path = "{root}/models/quality-control"
"#;

const EDGE: &str = r#"
[[pipeline]]
name = "offload"
sensor = { kind = "images", path = "{root}/models/quality-control/pictures" }
transforms = [{ kind = "resize", width = 320, height = 240 }, { kind = "encode", format = "jpeg", quality = 85 }]
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "quality-control" }
load = { mode = "rate", hz = 20.0 }
limit = { iterations = 40 }
actuator = { kind = "log" }
"#;

/// Stages of an offloaded iteration with a transform, in the order of every table.
const STAGES: [&str; 10] = [
    "sensing",
    "encode",
    "send-queue",
    "upload",
    "queue",
    "preprocessing",
    "inference",
    "postprocessing",
    "download",
    "actuation",
];

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} is no number in {value}"))
}

#[test]
fn offloaded_picture_is_stored_with_all_stages() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let cloud = deployment.start_agent("cloud", CLOUD);
    let edge = deployment.start_agent("edge", EDGE);

    // The API shows the pipeline while it runs. The third window is that of the last 60 s.
    api.wait_until("/api/v1/pipelines/edge/offload", |pipeline| {
        (number(&pipeline["windows"][2]["counts"], "ok") > 0.0).then_some(())
    });
    let run = api.wait_for_finished_run();

    // The run has exactly the configured iterations; warm-up is kept and flagged.
    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!(
        (detail["counts"]["ok"].as_u64(), detail["warm_up"].as_u64()),
        (Some(40), Some(5)),
        "{detail}"
    );
    assert_eq!(detail["placement"]["peer"], "cloud");

    // Both hosts share one clock, so every delay is exact, and the stages with the unattributed time add up to
    // the total.
    for name in STAGES {
        let stage = api.stage_statistics(run, name).unwrap_or_else(|| panic!("{name} is missing"));
        assert_eq!(stage["count"], 40, "{stage}");
        assert!(number(&stage, "min") >= 0.0, "{stage}");
    }
    api.assert_stages_sum_to_total(run, &STAGES);

    // One tree contains the nodes of both hosts.
    let iteration = api.json(&format!("/api/v1/runs/{run}/iterations/10"));
    assert_eq!(iteration["tree"]["anchors"].as_array().map(Vec::len), Some(2), "{iteration}");
    let nodes = iteration["tree"]["nodes"].as_array().expect("a list");
    let upload = nodes.iter().find(|node| node["name"] == "upload").expect("an upload");
    assert_eq!(upload["measure"]["transit"]["delay"]["source"], "same-clock", "{upload}");
    // The host of a node is an index of `anchors`; 0 is the edge.
    let inference = nodes.iter().find(|node| node["name"] == "inference").expect("an inference");
    assert_eq!(inference["host"], 1, "{inference}");

    // The pages show the run to a browser without scripts as well.
    for page in ["/", "/runs", &format!("/runs/{run}"), &format!("/runs/{run}/iterations/10"), "/hosts"] {
        let (status, text) = api.get(page).expect("the dashboard answers");
        assert_eq!(status, 200, "{page}");
        // The page of the hosts names no pipeline.
        assert!(text.contains("offload") || page == "/hosts", "{page}");
    }
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn stop_of_combined_process_loses_nothing() {
    let deployment = LoopbackDeployment::new();
    let configuration = std::fs::read_to_string(root().join("configs/all-in-one.toml"))
        .expect("the configuration is shipped");
    let configuration = configuration
        .replace("tcp://127.0.0.1:5550", "tcp://127.0.0.1:{events}")
        .replace("tcp://127.0.0.1:5551", "tcp://127.0.0.1:{data}")
        .replace("127.0.0.1:8040", "127.0.0.1:{http}")
        .replace("models/quality-control", "{root}/models/quality-control");
    deployment.write("all.toml", &configuration);
    let api = peernet_tests::Api::on_port(deployment.http_port);

    let first = deployment.start("all.toml");
    // Two pipelines run at the same time. The list of runs has a second entry only after both have
    // started.
    api.wait_until("/api/v1/runs", |runs| {
        (number(&runs["runs"].get(1)?["counts"], "ok") > 20.0).then_some(())
    });
    assert_eq!(first.stop().code(), 0);

    // After the second start, the runs of the first process have ended and contain everything that was measured.
    let second = deployment.start("all.toml");
    let runs = api.wait_until("/api/v1/runs", |runs| {
        let runs: Vec<Value> =
            runs["runs"].as_array()?.iter().filter(|run| run["reason"] == "stopped").cloned().collect();
        (runs.len() == 2).then_some(runs)
    });
    for run in &runs {
        let iterations = api.json(&format!("/api/v1/runs/{}/iterations?limit=1000", run["number"]));
        let iterations = iterations["iterations"].as_array().expect("a list");
        let numbers: Vec<usize> = iterations
            .iter()
            .filter_map(|iteration| iteration["number"].as_u64())
            .map(|number| number as usize)
            .collect();
        assert_eq!(numbers, (1..=numbers.len()).collect::<Vec<_>>(), "contiguous from the first to the last");
        // On a busy machine the last iteration may be given up; that outcome is counted, too.
        let iterations_by_outcome =
            ["ok", "failed", "lost", "timeout"].map(|outcome| number(&run["counts"], outcome));
        let counted = iterations_by_outcome.iter().sum::<f64>() + number(run, "warm_up");
        assert_eq!(counted as usize, numbers.len(), "{run}");
    }
    assert_eq!(second.stop().code(), 0);
}

#[test]
fn status_lists_pipelines_and_exits_69_without_aggregator() {
    let deployment = LoopbackDeployment::new();
    let url = format!("http://127.0.0.1:{}", deployment.http_port);
    let run_status = || {
        let arguments = ["status", "--url", url.as_str()];
        Process::start(&program("peernet"), &arguments, deployment.folder(), &[]).wait_for_end()
    };
    let without_aggregator = run_status();
    assert_eq!(without_aggregator.code(), 69, "{}", without_aggregator.log);
    assert!(without_aggregator.log.contains("--url"), "{}", without_aggregator.log);

    let (_aggregator, api) = deployment.start_aggregator();
    let edge = deployment.start_agent("edge", EDGE);
    // The pipeline waits for the cloud, which this test does not start.
    api.wait_until("/api/v1/pipelines/edge/offload", |pipeline| {
        (pipeline["state"] == "waiting").then_some(())
    });
    let status = run_status();
    assert_eq!(status.code(), 0, "{}", status.log);
    assert!(status.log.contains("edge/offload") && status.log.contains("waiting"), "{}", status.log);
    assert_eq!(edge.stop().code(), 0);
}
