//! Tests of the model that a peer gets, with and without the name of a model in its request.

use std::path::{Path, PathBuf};

use peernet_stream::{IncidentKind, Outcome, PipelineState};

use crate::harness::{Aggregator, TestAgent};

const SERVE: &str = "[serve]\nlisten = 'tcp://127.0.0.1:0'\n";
const ECHO: &str = "[[model]]\nname = 'echo'\nkind = 'echo'\n";

/// Returns the folder of the demo's model and pictures.
fn demo_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/quality-control")
}

/// Creates a folder with the demo model under two names.
fn model_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["plates", "plates_2"] {
        std::fs::create_dir(folder.path().join(name)).expect("made");
        for file in ["model.onnx", "model.toml"] {
            let to = folder.path().join(name).join(file);
            std::os::unix::fs::symlink(demo_folder().join(file), to).expect("linked");
        }
    }
    folder
}

/// Returns a pipeline that sends three pictures to the cloud, with further keys for its placement.
fn pipeline(cloud: &TestAgent, placement: &str) -> String {
    format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'images', path = {:?} }}\n\
         placement = {{ kind = 'remote', peer = '{}'{placement} }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 3 }}\n",
        demo_folder().join("pictures"),
        cloud.address()
    )
}

/// Waits until the pipeline's state is `Waiting`, and returns the reason.
async fn waiting_reason(edge: &TestAgent) -> String {
    match edge.until_state(|state| matches!(state, PipelineState::Waiting(_))).await {
        PipelineState::Waiting(reason) => reason,
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn edge_without_model_name_gets_the_only_model() {
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start("cloud", None, &format!("{SERVE}{ECHO}")).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &pipeline(&cloud, "")).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.run_starts()[0].placement.model.as_str(), "echo");
    assert_eq!(received_events.iterations().len(), 3);
    assert_eq!(cloud.running.served_counts().borrow().answers, 3);
    let hosts: Vec<&str> =
        received_events.run_starts()[0].conditions.iter().map(|condition| condition.host.as_str()).collect();
    assert!(hosts.contains(&"edge") && hosts.contains(&"cloud"), "both hosts were inspected: {hosts:?}");
    edge.stop().await.expect("stops well");

    // Answers of the calibration model are not counted.
    let calibrating = pipeline(&cloud, ", model = 'calibration'");
    let edge = TestAgent::start("edge", Some(&aggregator.address), &calibrating).await;
    aggregator.until(|received_events| received_events.run_ends().len() == 2).await;
    assert_eq!(cloud.running.served_counts().borrow().answers, 3);
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn edge_without_model_name_is_refused_with_names() {
    let nap = "[[model]]\nname = 'nap'\nkind = 'sleep'\n";
    let cloud = TestAgent::start("cloud", None, &format!("{SERVE}{ECHO}{nap}")).await;
    let edge = TestAgent::start("edge", None, &pipeline(&cloud, "")).await;
    let reason = waiting_reason(&edge).await;
    assert!(reason.contains("the request names no model") && reason.contains("echo, nap;"), "{reason}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn peer_gets_named_model_on_allowed_device() {
    let aggregator = Aggregator::start().await;
    let folder = model_folder();
    let bank = format!("{SERVE}[bank]\nfolders = [{:?}]\nmost_loaded = 1\n", folder.path());
    let cloud = TestAgent::start("cloud", None, &bank).await;
    let table = pipeline(&cloud, ", model = 'plates_2', device = 'cpu'");
    let edge = TestAgent::start("edge", Some(&aggregator.address), &table).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.run_starts()[0].placement.model.as_str(), "plates_2");
    assert!(
        received_events.run_starts()[0].facts.iter().any(|(name, _)| name == peernet_inference::MODEL_HASH)
    );
    let outcomes: Vec<&Outcome> =
        received_events.iterations().iter().map(|iteration| &iteration.outcome).collect();
    assert_eq!(outcomes, [&Outcome::Ok; 3]);
    edge.stop().await.expect("stops well");

    for (placement, expected) in [
        (", model = 'plates', device = 'cuda:0'", "only on cpu"),
        (", model = 'quality-control'", " offers plates, plates_2"),
    ] {
        let edge = TestAgent::start("edge", None, &pipeline(&cloud, placement)).await;
        let reason = waiting_reason(&edge).await;
        assert!(reason.contains(expected), "{reason}");
        edge.stop().await.expect("stops well");
    }
    let config_with_outside_path =
        toml::from_str::<peernet_agent::AgentConfig>(&pipeline(&cloud, ", model = '..'"));
    let error = config_with_outside_path.expect_err("no name leads out of the folder").to_string();
    assert!(error.contains("cannot be a name"), "{error}");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unloaded_model_is_incident_and_loaded_models_are_counted() {
    let aggregator = Aggregator::start().await;
    let folder = model_folder();
    let bank = format!("{SERVE}[bank]\nfolders = [{:?}]\nmost_loaded = 1\n", folder.path());
    let cloud = TestAgent::start("cloud", Some(&aggregator.address), &bank).await;
    for model in ["plates", "plates_2"] {
        let load = cloud.running.load_model(&model.parse().expect("a name"));
        load.await.expect("does not panic").expect("is there");
    }
    let received_events = aggregator
        .until(|received_events| {
            received_events.incidents(IncidentKind::ModelLoaded).len() == 2
                && received_events.incidents(IncidentKind::ModelUnloaded).len() == 1
        })
        .await;
    let text = &received_events.incidents(IncidentKind::ModelUnloaded)[0].text;
    assert!(text.starts_with("unloaded plates from cpu, where it was loaded for "), "{text}");
    assert!(text.contains(" s, to make room for plates_2; the process shrank by "), "{text}");
    cloud.until(|live| live.metrics.models.is_some_and(|models| models.loaded == 1)).await;
    cloud.stop().await.expect("stops well");
    // The agent unloads its models when it stops.
    let received_events = aggregator
        .until(|received_events| received_events.incidents(IncidentKind::ModelUnloaded).len() == 2)
        .await;
    let text = &received_events.incidents(IncidentKind::ModelUnloaded)[1].text;
    assert!(text.starts_with("unloaded plates_2 from cpu, where it was loaded for "), "{text}");
    assert!(text.ends_with(" s, because the agent stops"), "{text}");
}

#[test]
fn local_pipeline_may_use_model_bank() {
    let folder = model_folder();
    let tables = format!(
        "[bank]\nfolders = [{:?}]\n[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
         placement = {{ kind = 'local', model = 'plates' }}\n",
        folder.path()
    );
    let mut config = crate::harness::config(&tables);
    config.agent.state_dir = folder.path().to_owned();
    let problems = peernet_agent::Agent::check(&config, &crate::harness::clock("system"));
    assert!(problems.is_empty(), "{problems:?}");
    config.bank.devices = vec!["gpu".to_owned()];
    let problems = peernet_agent::Agent::check(&config, &crate::harness::clock("system"));
    assert_eq!(problems.iter().map(|problem| problem.key.as_str()).collect::<Vec<_>>(), ["bank.devices"]);
}
