//! Tests of the built-in model for `peernet calibrate`.

use peernet_stream::{Outcome, PipelineState};

use crate::harness::{Aggregator, TestAgent, value};

const CLOUD: &str = "[[model]]\nname = 'slow'\nkind = 'sleep'\n[serve]\nlisten = 'tcp://127.0.0.1:0'\n";

fn pipeline(cloud: &TestAgent) -> String {
    format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 3000 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'calibration' }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 5 }}\n",
        cloud.address()
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn serving_host_echoes_calibration_payload() {
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start("cloud", None, CLOUD).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &pipeline(&cloud)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 5);
    for iteration in received_events.iterations() {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert_eq!(value(&iteration.tree, "download-bytes"), Some(3000.0));
    }
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn disabled_calibration_is_refused_with_reason() {
    let cloud = TestAgent::start("cloud", None, &format!("{CLOUD}calibration = false\n")).await;
    let edge = TestAgent::start("edge", None, &pipeline(&cloud)).await;
    let state = edge.until_state(|state| matches!(state, PipelineState::Waiting(_))).await;
    let PipelineState::Waiting(reason) = state else { panic!("{state:?}") };
    assert!(reason.contains("calibration") && reason.contains("slow"), "{reason}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn configured_model_named_calibration_takes_precedence() {
    let aggregator = Aggregator::start().await;
    let configured_model = "[[model]]\nname = 'calibration'\nkind = 'echo'\nanswer_bytes = 7\n";
    let cloud = TestAgent::start("cloud", None, &format!("{CLOUD}{configured_model}")).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &pipeline(&cloud)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 5);
    assert!(received_events.iterations().iter().all(|it| value(&it.tree, "download-bytes") == Some(7.0)));
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
