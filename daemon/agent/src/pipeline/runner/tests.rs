//! Tests of pipelines in which a part panics, and of sensors that work while there is no connection.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use peernet_clock::{
    Clock, ClockIdentity, ManualClock, MonoTime, RawTime, SharedClock, Span, SystemClock, WallTime,
};
use peernet_external::exec::FingerprintKey;
use peernet_inference::Bank;
use peernet_logger::HostId;
use peernet_networks::PeerClock;
use peernet_sample::{Description, Sample};
use peernet_stream::{EndReason, Event, Outcome};
use tokio::sync::{oneshot, watch};

use super::super::iteration;
use super::super::load::Start;
use super::super::pipeline_loop::{PendingSample, PipelineLoop};
use super::super::preparation::Preparation;
use super::super::sensing::SensorOutput;
use super::*;
use crate::config::{AgentConfig, HostConfig};
use crate::event_queue::{EventCounter, QueueReceiver};
use crate::host::{EventSinks, Host};
use crate::incidents::Incidents;
use crate::link::{LinkContext, Links, ProbeSettings};
use crate::runs::Runs;

const PIPELINE: &str = "line";

/// A clock that panics once for one kind of reader, at the first reading after `panics_next` is set.
#[derive(Debug)]
struct PanickingClock {
    clock: SystemClock,
    panics_next: AtomicBool,
    reader: Reader,
}

/// Thread for which the clock panics.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reader {
    Any,
    /// The thread of the sensor, which has the name of the pipeline.
    Sensor,
}

impl Clock for PanickingClock {
    fn wall(&self) -> WallTime {
        self.clock.wall()
    }

    fn mono(&self) -> MonoTime {
        let is_reader = self.reader == Reader::Any || thread::current().name() == Some(PIPELINE);
        assert!(!(is_reader && self.panics_next.swap(false, Ordering::Relaxed)), "as planned");
        self.clock.mono()
    }

    fn raw(&self) -> RawTime {
        self.clock.raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.clock.identity()
    }
}

/// Returns a host with one pipeline, and the receiving end of its event queue.
fn context(
    sensor: &str,
    clock: SharedClock,
) -> (PipelineContext, Arc<PipelineConfig>, Arc<PipelineLiveState>, QueueReceiver) {
    let tables = format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = '{PIPELINE}'\nsensor = {sensor}\n\
         placement = {{ kind = 'local', model = 'echo' }}\nload = {{ mode = 'rate', hz = 100.0 }}"
    );
    let config: AgentConfig = toml::from_str(&tables).expect("a valid configuration");
    let aggregator = Some("tcp://127.0.0.1:1".parse().expect("an address"));
    let host_config = HostConfig { aggregator, ..HostConfig::default() };
    let (event_queue, receiver) = crate::event_queue::create(&host_config, &clock, EventCounter::default());
    let incidents = Incidents::new(Arc::clone(&clock), event_queue.clone());
    let (_host_clock_sender, host_clock) = watch::channel(PeerClock::default());
    let link_context = LinkContext {
        name: "edge".parse().expect("a name"),
        clock: Arc::clone(&clock),
        host_clock,
        event_queue: event_queue.clone(),
        incidents: incidents.clone(),
    };
    let probes = ProbeSettings::read(&config.probes, &config.clock).expect("no key is needed");
    let context = PipelineContext {
        host: Host {
            id: HostId::random(),
            name: link_context.name.clone(),
            version: "0.0.0",
            clock: Arc::clone(&clock),
        },
        events: EventSinks { event_queue, incidents, runs: Runs::default() },
        bank: Arc::new(Bank::new(config.models, config.onnxruntime, clock)),
        fingerprint_key: FingerprintKey::new([0; 32]),
        links: Links::new(link_context, &config.clock, probes),
        observed: crate::observed::ObservedPipelines::default(),
        inspection: Arc::default(),
    };
    let pipeline = Arc::new(config.pipelines.into_iter().next().expect("one pipeline"));
    let placement = crate::pipeline::describe_planned(&pipeline.placement);
    let live_state =
        Arc::new(PipelineLiveState::new(pipeline.name.clone(), pipeline.load.describe(), placement));
    (context, pipeline, live_state, receiver.expect("there is an aggregator"))
}

/// Runs a pipeline until the clock panics for this reader. Returns the reason for the end of the run, after checking
/// that the live state and an incident give the same reason.
async fn reason_after_panic(sensor: &str, reader: Reader) -> String {
    let system = SystemClock::new(ClockIdentity::new("boot", "system"));
    let panicking_clock =
        Arc::new(PanickingClock { clock: system, panics_next: AtomicBool::new(false), reader });
    let clock: SharedClock = Arc::<PanickingClock>::clone(&panicking_clock);
    let (context, pipeline, live_state, mut receiver) = context(sensor, clock);
    let running =
        run(pipeline, Arc::clone(&live_state), context, CancellationToken::new(), Duration::from_secs(1));
    let running = tokio::spawn(running);
    let mut started = None;
    while let Some(event) = receiver.next().await {
        match event {
            Event::RunStarted(run) => started = Some(run.run),
            Event::Iteration(_) => break,
            _ => {}
        }
    }
    panicking_clock.panics_next.store(true, Ordering::Relaxed);
    running.await.expect("the panic ends only the pipeline");

    let (mut ended, mut incident) = (None, None);
    while ended.is_none() || incident.is_none() {
        match receiver.next().await.expect("the run ends and the failure is reported") {
            Event::RunEnded(end) => ended = Some(end),
            Event::Incident(found) if found.kind == IncidentKind::PipelineFailed => incident = Some(found),
            _ => {}
        }
    }
    let ended = ended.expect("the loop has received the end of the run");
    assert_eq!(Some(ended.run), started);
    let reason = ended.reason.failure().expect("the run failed").to_owned();
    assert_eq!(incident.expect("the loop has received the incident").text, reason);
    let (pipelines, _) = crate::live::LiveStatistics::new(vec![live_state]).snapshot();
    assert_eq!(pipelines[0].state, PipelineState::Failed(reason.clone()));
    reason
}

#[tokio::test]
async fn panic_fails_pipeline_with_reason_and_ends_run() {
    let reason = reason_after_panic("{ kind = 'synthetic', size_bytes = 1 }", Reader::Any).await;
    assert!(reason.contains("panicked: as planned"), "{reason}");
}

#[tokio::test]
async fn sensor_panic_fails_pipeline_and_is_given_as_reason() {
    let reason = reason_after_panic("{ kind = 'text', length = 5000 }", Reader::Sensor).await;
    assert!(reason.contains("the sensor's thread has panicked"), "{reason}");
}

/// Returns the outcomes that are recorded after a reconnect if the sensor returned a sample in the meantime.
/// `requesting_run` returns the run that had requested the sample; its argument is the current run.
async fn outcomes_after_reconnect(requesting_run: impl FnOnce(RunId) -> RunId) -> Vec<Outcome> {
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
    let sensor = "{ kind = 'synthetic', size_bytes = 1 }";
    let (context, pipeline, live_state, mut receiver) = context(sensor, Arc::clone(&clock));
    let mut resources = PipelineResources::assemble(
        Arc::clone(&pipeline),
        Arc::clone(&live_state),
        Arc::clone(&clock),
        &context.fingerprint_key,
    )
    .expect("a sensor that can be opened");
    let description = crate::pipeline::describe_planned(&pipeline.placement);
    let (facts, conditions, is_continuation) = (Vec::new(), Vec::new(), false);
    let mut run =
        Run::start(&pipeline, description, (facts, conditions), is_continuation, &context, &live_state);

    let start = Start { intended: clock.mono(), skipped: 0 };
    let (log, started_at) = iteration::start(&clock, context.host.id, start.intended);
    let (sample_sender, sample) = oneshot::channel();
    let arrived_sample = Sample::from_part(Description::bytes(), "x".into());
    assert!(
        sample_sender.send(SensorOutput { log, sample: Ok(Some(arrived_sample)) }).is_ok(),
        "the receiver of the sample exists"
    );
    resources.pending_sample =
        Some(PendingSample { run: requesting_run(run.id()), start, started_at, sample });
    // A pipeline gets a new loop after a reconnect. The new loop takes the sample that has arrived.
    drop(PipelineLoop::new(&mut resources, &mut run, &context));
    assert!(resources.pending_sample.is_none());
    run.end(EndReason::Stopped, &context);
    let mut outcomes = Vec::new();
    loop {
        match receiver.next().await.expect("the end is recorded") {
            Event::Iteration(iteration) => outcomes.push(iteration.outcome),
            Event::RunEnded(_) => return outcomes,
            _ => {}
        }
    }
}

#[tokio::test]
async fn sample_that_arrives_without_connection_is_recorded_as_lost() {
    let outcomes = outcomes_after_reconnect(|current| current).await;
    assert!(
        matches!(outcomes.as_slice(), [Outcome::Lost(reason)] if reason.contains("no connection")),
        "{outcomes:?}"
    );
}

#[tokio::test]
async fn sample_requested_by_earlier_run_is_not_recorded() {
    assert_eq!(outcomes_after_reconnect(|_| RunId::random()).await, []);
}

#[tokio::test]
async fn outage_during_advance_does_not_delay_later_starts() {
    let clock =
        Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
    let shared_clock: SharedClock = Arc::<ManualClock>::clone(&clock);
    let sensor = "{ kind = 'synthetic', size_bytes = 1 }";
    let (context, config, live_state, _receiver) = context(sensor, Arc::clone(&shared_clock));
    let mut resources = PipelineResources::assemble(
        Arc::clone(&config),
        Arc::clone(&live_state),
        shared_clock,
        &context.fingerprint_key,
    )
    .expect("a sensor that can be opened");
    let (stop, drain_timeout) = (CancellationToken::new(), Duration::ZERO);
    let runner = Runner { config, live_state, context, stop, drain_timeout };
    resources.start_preparation(Preparation::Advance(Span::ZERO), clock.mono());
    clock.advance(Span::from_seconds(60));
    let (no_run, no_pause) = (None, Duration::ZERO);
    let mut reconnect_backoff = ReconnectBackoff::new(HostId::from_bytes([7; 16]));
    let connecting = runner.connect(&mut resources, no_run, no_pause, &mut reconnect_backoff);
    assert!(connecting.await.expect("no error").is_some(), "it is connected");
    resources.pending_preparation.take().expect("it is in progress").await.expect("the sensor is advanced");
    let now = clock.mono();
    resources.resume_schedule(now);
    resources.schedule.skip_due(now);
    let wait = resources.schedule.next_at(now) - now;
    assert!(wait <= Span::from_millis(10), "there are 100 starts per second: {wait}");
    assert!(resources.schedule.unreported_skips() >= 6_000, "the starts during the outage are counted");
}
