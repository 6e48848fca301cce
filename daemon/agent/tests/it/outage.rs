//! Tests of clouds that are absent, go away and come back.

use std::time::Duration;

use peernet_stream::{EndReason, IncidentKind, Iteration, Outcome, PipelineState};
use peernet_test_ports::free_port;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::Instant;

use crate::harness::{Aggregator, ReceivedEvents, TestAgent, assert_contiguous, value};

fn cloud(port: u16) -> String {
    format!(
        "[serve]\nlisten = 'tcp://127.0.0.1:{port}'\n[[model]]\nname = 'slow'\nkind = 'sleep'\n\
         preprocessing_ms = 0\ninference_ms = 30\npostprocessing_ms = 0\n"
    )
}

fn edge(port: u16, model: &str) -> String {
    format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 1000 }}\n\
         placement = {{ kind = 'remote', peer = 'tcp://127.0.0.1:{port}', model = '{model}' }}\n\
         load = {{ mode = 'rate', hz = 50.0 }}\n"
    )
}

/// Starts to forward connections to `port`. Returns the port that accepts them, and the task. When the task is aborted,
/// the connections end without a goodbye.
async fn forward_port(port: u16) -> (u16, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let accepting_port = listener.local_addr().expect("bound").port();
    let forwarding = tokio::spawn(async move {
        let mut connections = JoinSet::new();
        while let Ok((mut edge_side, _)) = listener.accept().await {
            connections.spawn(async move {
                let mut cloud_side = TcpStream::connect(("127.0.0.1", port)).await?;
                tokio::io::copy_bidirectional(&mut edge_side, &mut cloud_side).await
            });
        }
    });
    (accepting_port, forwarding)
}

fn is_waiting(state: &PipelineState) -> bool {
    matches!(state, PipelineState::Waiting(_))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn edge_waits_for_cloud_that_is_not_up() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge(port, "slow")).await;
    let PipelineState::Waiting(reason) = edge.until_state(is_waiting).await else { unreachable!() };
    assert!(reason.contains(&port.to_string()), "{reason}");
    let received_events = aggregator
        .until(|received_events| !received_events.incidents(IncidentKind::Disconnected).is_empty())
        .await;
    let reported = received_events.incidents(IncidentKind::Disconnected)[0].text.clone();
    assert!(reported.contains("the pipeline continues automatically"), "{reported}");
    assert!(received_events.run_starts().is_empty(), "no run has started");

    let cloud = TestAgent::start("cloud", None, &cloud(port)).await;
    let received_events = aggregator.until(|received_events| received_events.iterations().len() >= 5).await;
    assert_eq!(received_events.run_starts().len(), 1);
    assert_eq!(
        received_events.incidents(IncidentKind::Disconnected).len(),
        1,
        "the absence is reported once"
    );
    // Starts that came due before the first connection are neither late nor skipped: the schedule begins with the
    // run.
    let (iterations, started) = (received_events.iterations(), received_events.run_starts()[0].started);
    let first = iterations.iter().find(|it| it.number == 1).expect("the first");
    assert_eq!(value(&first.tree, "skipped-starts"), None);
    assert!(iterations.iter().all(|it| it.tree.anchors()[0].wall >= started), "{started:?}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn dead_cloud_loses_iterations_in_flight_and_run_continues() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let first = TestAgent::start("cloud", None, &cloud(port)).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge(port, "slow")).await;
    aggregator.until(|received_events| received_events.iterations().len() >= 10).await;
    first.kill();
    let lost = |outcome: &Outcome| matches!(outcome, Outcome::Lost(_));
    let received_events = aggregator
        .until(|received_events| received_events.iterations().iter().any(|it| lost(&it.outcome)))
        .await;
    let before = received_events.iterations().len();
    let iterations = received_events.iterations();
    let reason = iterations.iter().find_map(|it| it.outcome.reason()).expect("a reason");
    assert!(!reason.is_empty());
    edge.until_state(is_waiting).await;

    let second = TestAgent::start("cloud", None, &cloud(port)).await;
    let received_events =
        aggregator.until(|received_events| received_events.iterations().len() >= before + 20).await;
    assert_eq!(received_events.run_starts().len(), 1, "the same run");
    assert!(received_events.run_ends().is_empty());
    let incidents = received_events.incidents(IncidentKind::Disconnected);
    assert!(
        incidents.iter().any(|it| it.peer.is_some() && it.run == Some(received_events.run_starts()[0].run)),
        "{incidents:?}"
    );
    edge.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_contiguous(&received_events.iterations());
    assert_eq!(received_events.run_ends()[0].reason, EndReason::Stopped);
    second.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cloud_that_closes_sessions_is_reached_after_growing_pauses() {
    let port = free_port();
    let cloud = TestAgent::start("cloud", None, &cloud(port)).await;
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let forwarded_port = listener.local_addr().expect("bound").port();
    let edge = TestAgent::start("edge", None, &edge(forwarded_port, "slow")).await;
    let mut connected_at = Vec::new();
    for _ in 0..4 {
        let (mut edge_side, _) = listener.accept().await.expect("the edge connects");
        connected_at.push(Instant::now());
        let mut cloud_side = TcpStream::connect(("127.0.0.1", port)).await.expect("the cloud listens");
        tokio::select! {
            end = tokio::io::copy_bidirectional(&mut edge_side, &mut cloud_side) => panic!("{end:?}"),
            _ = edge.until_state(|state| *state == PipelineState::Running) => {}
        }
        drop((edge_side, cloud_side));
        edge.until_state(is_waiting).await;
    }
    // The three pauses are 0.25 s, 0.5 s and 1 s, ± 20 %.
    let elapsed = connected_at[3] - connected_at[0];
    assert!(elapsed >= Duration::from_millis(1_400), "{elapsed:?}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn short_outage_while_sensor_waits_loses_no_sample() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let folder = tempfile::tempdir().expect("a folder");
    let gate = folder.path().join("gate");
    let made = std::process::Command::new("mkfifo").arg(&gate).status();
    assert!(made.expect("is there").success());
    // Each sample waits until the gate is opened once.
    let script = format!("while read -r next; do cat {} > /dev/null; echo answer 0; done", gate.display());
    let open = || {
        let gate = gate.clone();
        tokio::task::spawn_blocking(move || std::fs::write(gate, "go").expect("a reader"))
    };
    let tables = format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'exec', command = '{script}', timeout_ms = 600000 }}\n\
         placement = {{ kind = 'remote', peer = 'tcp://127.0.0.1:{port}', model = 'slow' }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 2 }}\n"
    );
    let first = TestAgent::start("cloud", None, &cloud(port)).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    open().await.expect("opens");
    aggregator.until(|received_events| received_events.iterations().len() == 1).await;
    first.kill();
    edge.until_state(is_waiting).await;
    let second = TestAgent::start("cloud", None, &cloud(port)).await;
    edge.until_state(|state| *state == PipelineState::Running).await;
    open().await.expect("opens");
    let received_events = aggregator.until(|received_events| received_events.iterations().len() == 2).await;
    assert!(
        received_events.iterations().iter().all(|it| it.outcome == Outcome::Ok),
        "{:?}",
        received_events.iterations()
    );
    assert_eq!(received_events.run_starts().len(), 1, "the same run");
    edge.stop().await.expect("stops well");
    second.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_that_loses_its_last_iteration_is_finished() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let folder = tempfile::tempdir().expect("a folder");
    let gate = folder.path().join("gate");
    let made = std::process::Command::new("mkfifo").arg(&gate).status();
    assert!(made.expect("is there").success());
    // The gate can be opened once the model has the request. The model ends when the gate is opened again.
    let script = format!(
        "while read -r next; do cat {0} > /dev/null; cat {0} > /dev/null; exit 1; done",
        gate.display()
    );
    let tables = format!(
        "[serve]\nlisten = 'tcp://127.0.0.1:{port}'\n[[model]]\nname = 'slow'\nkind = 'exec'\ncommand = '{script}'\n"
    );
    let cloud = TestAgent::start("cloud", None, &tables).await;
    let (forwarded_port, forwarding) = forward_port(port).await;
    let tables = edge(forwarded_port, "slow").replace(
        "load = { mode = 'rate', hz = 50.0 }",
        "timeout_ms = 600000\nwarm_up = { iterations = 0 }\nlimit = { iterations = 1 }",
    );
    let edge = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let opened_gate = gate.clone();
    let request_arrived = tokio::task::spawn_blocking(move || std::fs::write(opened_gate, "go"));
    request_arrived.await.expect("no panic").expect("the model reads the gate");
    forwarding.abort();

    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.run_ends()[0].reason, EndReason::Finished);
    let iterations = received_events.iterations();
    assert!(matches!(iterations[..], [Iteration { outcome: Outcome::Lost(_), .. }]), "{iterations:?}");
    edge.until_state(|state| *state == PipelineState::Finished).await;
    edge.stop().await.expect("stops well");
    // A FIFO that is opened for both directions does not wait for a reader.
    drop(std::fs::File::options().read(true).write(true).open(&gate).expect("the gate is there"));
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unknown_model_is_refused_with_list_of_models() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let cloud = TestAgent::start("cloud", Some(&aggregator.address), &cloud(port)).await;
    let edge = TestAgent::start("edge", None, &edge(port, "fast")).await;
    let PipelineState::Waiting(reason) = edge.until_state(is_waiting).await else { unreachable!() };
    assert!(reason.contains("no model named fast") && reason.contains("slow"), "{reason}");
    let received_events = aggregator
        .until(|received_events| !received_events.incidents(IncidentKind::Refused).is_empty())
        .await;
    let reported = &received_events.incidents(IncidentKind::Refused)[0].text;
    assert!(
        reported.contains("edge") && reported.contains("line") && reported.contains("fast"),
        "{reported}"
    );
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refusal_of_wrong_device_names_device_of_model() {
    let port = free_port();
    let cloud = TestAgent::start("cloud", None, &cloud(port)).await;
    let tables = edge(port, "slow").replace("model = 'slow'", "model = 'slow', device = 'cuda:0'");
    let edge = TestAgent::start("edge", None, &tables).await;
    let PipelineState::Waiting(reason) = edge.until_state(is_waiting).await else { unreachable!() };
    assert!(reason.contains("cuda:0") && reason.contains("only on cpu"), "{reason}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_session_end_without_goodbye_is_incident() {
    let (aggregator, port) = (Aggregator::start().await, free_port());
    let cloud = TestAgent::start("cloud", Some(&aggregator.address), &cloud(port)).await;
    let mut served = cloud.running.served_counts();
    let limited = format!("{}limit = {{ iterations = 5 }}\n", edge(port, "slow"));
    let first = TestAgent::start("first", None, &limited).await;
    served.wait_for(|served| served.answers >= 5 && served.sessions == 0).await.expect("serves");
    first.stop().await.expect("stops well");

    let (forwarded_port, forwarding) = forward_port(port).await;
    let second = TestAgent::start("second", None, &edge(forwarded_port, "slow")).await;
    served.wait_for(|served| served.sessions == 1).await.expect("serves");
    forwarding.abort();
    let received_events = aggregator
        .until(|received_events| !received_events.incidents(IncidentKind::Disconnected).is_empty())
        .await;
    let lost: Vec<&str> =
        received_events.incidents(IncidentKind::Disconnected).iter().map(|it| it.text.as_str()).collect();
    assert!(matches!(lost[..], [text] if text.starts_with("lost the connection to second: ")), "{lost:?}");
    assert_eq!(served.borrow().sessions, 0);
    second.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_ended_without_aggregator_are_counted() {
    let port = free_port();
    let cloud = TestAgent::start("cloud", None, &cloud(port)).await;
    let absent_aggregator = Aggregator::start().await.stop().await;
    let tables = format!("{}limit = {{ iterations = 3 }}\n", edge(port, "slow"));
    let edge = TestAgent::start("edge", Some(&absent_aggregator.0), &tables).await;
    edge.until_state(|state| *state == PipelineState::Finished).await;
    edge.until(|live| live.links.is_empty()).await;

    let connection_texts = |received_events: &ReceivedEvents| {
        let texts = received_events
            .incidents(IncidentKind::Connected)
            .into_iter()
            .map(|incident| incident.text.clone());
        texts.filter(|text| text.starts_with("connected to the aggregator")).collect::<Vec<_>>()
    };
    let aggregator = Aggregator::restart(absent_aggregator).await;
    let received_events =
        aggregator.until(|received_events| connection_texts(received_events).len() == 1).await;
    let reported = &connection_texts(&received_events)[0];
    assert!(reported.contains("1 connection to a cloud ended in the meantime"), "{reported}");
    // The live update begins a new count, so the number is not reported again.
    aggregator.until(|received_events| !received_events.live_updates.is_empty()).await;

    let aggregator = Aggregator::restart(aggregator.stop().await).await;
    let received_events =
        aggregator.until(|received_events| connection_texts(received_events).len() == 2).await;
    let reported = &connection_texts(&received_events)[1];
    assert!(!reported.contains("ended in the meantime"), "{reported}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
