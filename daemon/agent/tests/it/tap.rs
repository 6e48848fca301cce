//! Tests of a program that runs an agent in the foreground.

use std::num::NonZeroU64;
use std::time::Duration;

use peernet_agent::{Agent, MissedEvents, StartError};
use peernet_stream::{Event, PipelineState};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::harness::{VERSION, WAIT_TIMEOUT, clock, config};

/// Configuration of a pipeline and its model.
const PIPELINE_TABLES: &str = "[[model]]\nname = 'echo'\nkind = 'echo'\n\
    [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 10 }\n\
    placement = { kind = 'local', model = 'echo' }\nwarm_up = { iterations = 0 }\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unreadable_host_secret_is_refused_before_anything_starts() {
    let state = tempfile::tempdir().expect("a folder");
    std::fs::write(state.path().join("host-secret"), "my notes").expect("written");
    let mut config = config(PIPELINE_TABLES);
    config.agent.name = Some("edge".parse().expect("a name"));
    config.agent.state_dir = state.path().to_owned();
    config.agent.aggregator = Some("tcp://127.0.0.1:9".parse().expect("an address"));
    let (tap, mut events) = mpsc::channel(1000);
    let (stop, results) = (CancellationToken::new(), None);
    let started = Agent::start_with_tap(config, VERSION, clock("system"), stop, tap, results).await;
    let error = started.expect_err("the file contains no secret");
    assert!(matches!(error, StartError::Identity(_)) && error.to_string().contains("host-secret"), "{error}");
    assert_eq!(events.recv().await, None, "no pipeline ran");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn program_receives_events_and_missed_events_are_counted() {
    for capacity in [1000, 10] {
        let state = tempfile::tempdir().expect("a folder");
        let mut config = config(PIPELINE_TABLES);
        config.agent.name = Some("edge".parse().expect("a name"));
        config.agent.state_dir = state.path().to_owned();
        config.pipelines[0].limit.iterations = NonZeroU64::new(100);
        let (stop, results) = (CancellationToken::new(), None);
        let (tap, mut events) = mpsc::channel(capacity);
        let running = Agent::start_with_tap(config, VERSION, clock("system"), stop.clone(), tap, results)
            .await
            .expect("starts");
        // The state is polled, because changes are not announced.
        let finished = async {
            while running.live_update().pipelines[0].state != PipelineState::Finished {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(WAIT_TIMEOUT, finished).await.expect("the pipeline finishes");
        let missed_event_counters = running.missed_event_counters();
        stop.cancel();
        running.join().await.expect("stops well");
        let mut received_events = Vec::new();
        while let Some(event) = events.recv().await {
            received_events.push(event);
        }
        let missed_events = missed_event_counters.read();
        let iterations = received_events.iter().filter(|event| matches!(event, Event::Iteration(_))).count();
        let ended = received_events.iter().filter(|event| matches!(event, Event::RunEnded(_))).count();
        if capacity > 104 {
            // The events are: model loaded, model unloaded, run started, run ended, and 100 iterations.
            assert_eq!(received_events.len(), 104);
            assert_eq!((iterations, ended, missed_events), (100, 1, MissedEvents::default()));
        } else {
            // The channel has the load of the model, the start of the run and 8 iterations. The
            // missed events are the other 92 iterations, the end of the run, and the unloading of
            // the model while the agent stops.
            let expected = MissedEvents { iterations: 92, others: 2 };
            assert_eq!((received_events.len(), missed_events), (capacity, expected));
        }
    }
}
