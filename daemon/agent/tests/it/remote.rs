//! Tests of a pipeline between two hosts.

use peernet_clock::{DelaySource, Verdict};
use peernet_logger::Measure;
use peernet_stream::{IncidentKind, Iteration, Outcome, PlacementKind};

use crate::harness::{Aggregator, TestAgent, VERSION, assert_adds_up, assert_contiguous, value};

const CLOUD: &str = "[serve]\nlisten = 'tcp://127.0.0.1:0'\n\
    [[model]]\nname = 'echo'\nkind = 'echo'\n\
    [[model]]\nname = 'slow'\nkind = 'sleep'\npreprocessing_ms = 1\ninference_ms = 20\npostprocessing_ms = 1\n";

fn edge(cloud: &TestAgent, model: &str, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 20000 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = '{model}' }}\n\
         warm_up = {{ iterations = 0 }}\n{keys}",
        cloud.address()
    )
}

fn delay(iteration: &Iteration, name: &str) -> peernet_clock::OneWayDelay {
    let (_, node) = iteration.tree.find(&[name]).unwrap_or_else(|| panic!("{name} in {:?}", iteration.tree));
    match &node.measure {
        Measure::Transit(transit) => transit.delay.expect("judged"),
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn same_clock_gives_exact_delays() {
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start("cloud", None, CLOUD).await;
    let tables = edge(&cloud, "echo", "limit = { iterations = 50 }");
    let edge = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;

    let iterations = received_events.iterations();
    assert_eq!(iterations.len(), 50);
    for iteration in &iterations {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert_adds_up(iteration);
        for name in ["upload", "download"] {
            let delay = delay(iteration, name);
            assert_eq!((delay.source, delay.verdict), (DelaySource::SameClock, Verdict::Ok));
            assert!(delay.value.is_some_and(|value| !value.is_negative()));
        }
        assert_eq!(value(&iteration.tree, "upload-bytes"), Some(20000.0));
        assert_eq!(value(&iteration.tree, "download-bytes"), Some(20000.0));
        let (bytes, seconds) =
            (value(&iteration.tree, "upload-logger-bytes"), value(&iteration.tree, "upload"));
        let (Some(logger_bytes), Some(seconds)) = (bytes, seconds) else { panic!("{:?}", iteration.tree) };
        let throughput = value(&iteration.tree, "upload-throughput").expect("a throughput");
        assert!((throughput * seconds - 8.0 * (20000.0 + logger_bytes)).abs() < 1.0);
        assert!(value(&iteration.tree, "download-throughput").is_some());
        assert_eq!(iteration.tree.anchors().len(), 2, "both hosts are in the tree");
    }
    let run = received_events.run_starts()[0];
    let serving_cloud = edge.running.serving_cloud(&run.pipeline).expect("a cloud served the pipeline");
    assert_eq!((run.version.as_str(), serving_cloud.version.as_str()), (VERSION, VERSION));
    assert_eq!(run.placement.kind, PlacementKind::Remote);
    assert_eq!(run.placement.peer.as_ref().map(peernet_logger::Slug::as_str), Some("cloud"));
    assert_eq!(
        (run.placement.network.as_deref(), run.placement.device.as_deref()),
        (Some("zmq-tcp"), Some("cpu"))
    );
    assert_eq!(
        received_events.incidents(IncidentKind::Connected).iter().filter(|it| it.peer.is_some()).count(),
        1
    );
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn several_requests_are_in_flight_at_once() {
    let aggregator = Aggregator::start().await;
    let cloud = CLOUD.replace("kind = 'sleep'", "kind = 'sleep'\nworkers = 4");
    let cloud = TestAgent::start("cloud", None, &cloud).await;
    let keys = "load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 4\nlimit = { iterations = 60 }";
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge(&cloud, "slow", keys)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    assert_contiguous(&iterations);
    // The model takes 22 ms: if requests were sent one at a time, the iterations could not overlap.
    let span = |it: &Iteration| {
        let begin = it.tree.anchors()[0].wall.unix_nanos();
        (begin, begin + (value(&it.tree, "total").unwrap_or(0.0) * 1e9) as i64)
    };
    let overlapping = iterations.iter().filter(|it| {
        let (begin, end) = span(it);
        iterations
            .iter()
            .any(|other| other.number != it.number && span(other).0 < end && begin < span(other).1)
    });
    assert!(overlapping.count() > 10);
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn overloaded_cloud_is_reported() {
    let aggregator = Aggregator::start().await;
    let cloud = CLOUD.replace("kind = 'sleep'", "kind = 'sleep'\nworkers = 1\nqueue = 1");
    let cloud = TestAgent::start("cloud", None, &cloud).await;
    let keys = "load = { mode = 'rate', hz = 400.0 }\nmax_in_flight = 16\nlimit = { iterations = 40 }";
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge(&cloud, "slow", keys)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let overloaded = received_events.iterations().into_iter().filter(|it| {
        matches!(&it.outcome, Outcome::Failed(reason) if reason.contains("overloaded") && reason.contains("full"))
    });
    assert!(overloaded.count() > 0);
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn late_remote_answer_is_timeout() {
    let aggregator = Aggregator::start().await;
    let cloud =
        TestAgent::start("cloud", None, &CLOUD.replace("inference_ms = 20", "inference_ms = 300")).await;
    let keys = "timeout_ms = 30\ndeadline_ms = 20\nlimit = { iterations = 3 }";
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge(&cloud, "slow", keys)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    for iteration in received_events.iterations() {
        let Outcome::Timeout(reason) = &iteration.outcome else { panic!("{:?}", iteration.outcome) };
        for part in ["cloud cloud", "model slow", "within 30", "timeout_ms", "--timeout"] {
            assert!(reason.contains(part), "{part} is missing in {reason}");
        }
    }
    assert_eq!(received_events.iterations().len(), 3);
    assert!(received_events.iterations().iter().all(|it| value(&it.tree, "deadline-missed") == Some(1.0)));
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
