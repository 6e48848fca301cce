//! Test of a run whose latencies are drawn from a distribution.

use crate::harness::{Aggregator, TestAgent, assert_adds_up};

const TABLES: &str = "
[[model]]
name = 'echo'
kind = 'echo'

[[model]]
name = 'gpu'
kind = 'distribution'
device = 'A5000'
mean_ms = 2.0
std_ms = 0.5
seed = 0
inner = 'echo'

[[pipeline]]
name = 'line'
sensor = { kind = 'synthetic', size_bytes = 100 }
placement = { kind = 'local', model = 'gpu' }
warm_up = { iterations = 0 }
limit = { iterations = 3 }
";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_states_that_its_latencies_are_drawn() {
    let aggregator = Aggregator::start().await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), TABLES).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let run = received_events.run_starts()[0];
    let fact = |name: &str| run.facts.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
    let expected = "inference is drawn from a log-normal distribution with mean 2 ms and standard deviation 0.5 ms, seed 0";
    assert_eq!(fact("Replayed"), Some(expected));
    assert_eq!((fact("Model"), fact("Inner model")), (Some("replayed latencies"), Some("echo")));
    for iteration in received_events.iterations() {
        let value = |path: &[&str]| iteration.tree.find(path).and_then(|(_, node)| node.measure.value());
        let drawn = value(&["inference", "drawn-latency"]);
        assert!(drawn > Some(0.0) && value(&["inference"]) >= drawn, "{drawn:?}");
        assert!(value(&["download-bytes"]).is_none());
        assert_adds_up(iteration);
    }
    edge.stop().await.expect("stops well");
}
