//! Tests of stopping: iterations in flight are completed, and their events are sent.

use std::net::UdpSocket;
use std::path::Path;

use peernet_stream::{EndReason, Outcome};

use crate::harness::{Aggregator, TestAgent, assert_contiguous};

const SLOW: &str = "[[model]]\nname = 'slow'\nkind = 'sleep'\ninference_ms = 100\nworkers = 4\n\
    [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\nwarm_up = { iterations = 0 }\n\
    placement = { kind = 'local', model = 'slow' }\nload = { mode = 'rate', hz = 40.0 }\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn iterations_in_flight_are_finished_before_stop() {
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), SLOW).await;
    aggregator.until(|received_events| received_events.iterations().len() >= 4).await;
    let host = agent.running.live_update().host;
    agent.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    assert_eq!(received_events.goodbyes, [host]);
    let last = received_events.live_updates.last().expect("the agent sent live updates");
    assert_eq!(last.pipelines[0].state, peernet_stream::PipelineState::Finished);
    assert_eq!((last.accounting.waiting, last.accounting.stored), (0, last.accounting.produced));
    assert_eq!(received_events.run_ends()[0].reason, EndReason::Stopped);
    assert_contiguous(&received_events.iterations());
    assert!(received_events.iterations().iter().all(|iteration| iteration.outcome == Outcome::Ok));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn iterations_beyond_stop_timeout_are_lost() {
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[agent]\nstop_timeout_ms = 1000\n{}",
        SLOW.replace("inference_ms = 100", "inference_ms = 1500")
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|received_events| !received_events.run_starts().is_empty()).await;
    agent.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    let lost = |outcome: &Outcome| matches!(outcome, Outcome::Lost(reason) if reason.contains("stopped"));
    assert!(
        received_events.iterations().iter().any(|iteration| lost(&iteration.outcome)),
        "{:?}",
        received_events.iterations()
    );
    assert_contiguous(&received_events.iterations());
    assert_eq!(received_events.run_ends().len(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stop_does_not_wait_for_slow_model() {
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[agent]\nstop_timeout_ms = 2000\n{}",
        SLOW.replace("inference_ms = 100", "inference_ms = 86400000")
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|received_events| !received_events.run_starts().is_empty()).await;
    agent.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    assert_eq!(received_events.run_ends().len(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn agent_without_aggregator_measures_and_stops() {
    let agent = TestAgent::start("edge", None, SLOW).await;
    agent.until_state(|state| *state == peernet_stream::PipelineState::Running).await;
    agent.stop().await.expect("stops well");
}

/// A sensor that holds a UDP port, and an actuator whose reset opens the file `GATE` and then takes longer than the test.
// The process of the sensor needs some time to end, as a simulation with much memory does.
const HOLDER_OF_PORT: &str = "\
import atexit, os, socket, time
class Sensor:
    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(('127.0.0.1', int(os.environ['PORT'])))
        atexit.register(time.sleep, 0.4)
    def sample(self): return b'sample'

class Arm:
    def reset(self):
        open(os.environ['GATE'], 'w').close()
        time.sleep(60)
    def act(self, answer): pass
";

/// Returns a pipeline whose sensor holds `port`. The folder is for the module of the sensor.
fn pipeline_with_port(folder: &Path, port: u16) -> String {
    std::fs::write(folder.join("own.py"), HOLDER_OF_PORT).expect("can be written");
    format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nplacement = {{ kind = 'local', model = 'echo' }}\n\
         sensor = {{ kind = 'python', object = 'own::Sensor', folder = '{}', env = {{ PORT = '{port}' }} }}\n",
        folder.display()
    )
}

fn free_udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a free port").port()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn port_of_sensor_is_free_after_stop_during_reset() {
    let (folder, port) = (tempfile::tempdir().expect("a folder"), free_udp_port());
    let gate = folder.path().join("gate");
    let made = std::process::Command::new("mkfifo").arg(&gate).status();
    assert!(made.expect("is there").success());
    let tables = format!(
        "{}actuator = {{ kind = 'python', object = 'own::Arm', folder = '{}', env = {{ GATE = '{}' }}, timeout_ms = 2000 }}\n\
         episode_steps = 2\n",
        pipeline_with_port(folder.path(), port),
        folder.path().display(),
        gate.display()
    );
    let agent = TestAgent::start("edge", None, &tables).await;
    // The file can be read once the reset has opened it.
    tokio::task::spawn_blocking(move || std::fs::read(gate))
        .await
        .expect("no panic")
        .expect("the reset began");
    assert!(UdpSocket::bind(("127.0.0.1", port)).is_err(), "the sensor has the port");
    agent.stop().await.expect("stops well");
    UdpSocket::bind(("127.0.0.1", port)).expect("the sensor has released its port");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn port_of_sensor_is_free_after_stop() {
    let (folder, port) = (tempfile::tempdir().expect("a folder"), free_udp_port());
    let tables = pipeline_with_port(folder.path(), port);
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|received_events| !received_events.iterations().is_empty()).await;
    assert!(UdpSocket::bind(("127.0.0.1", port)).is_err(), "the sensor has the port");
    agent.stop().await.expect("stops well");
    UdpSocket::bind(("127.0.0.1", port)).expect("the sensor has released its port");
}
