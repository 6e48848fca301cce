//! Running of an agent in the foreground: it is started, observed until it is done or a signal ends it, and stopped.
//!
//! Three commands use it: `calibrate` studies a link, `measure` records a run, and the published `--server` serves. They differ
//! in their observer ([`RunObserver`]); starting, signals and stopping are the same. Events come from the agent's tap; the
//! rest of its state is read several times a second.

mod command_line;
mod dashboard;
mod duration;
mod ended;
mod latency;
mod log;
mod peer_wait;
mod progress;
mod remark;
mod signals;
mod tables;

pub(crate) use command_line::command_line;
pub(crate) use dashboard::dashboard_hint;
pub(crate) use duration::duration;
pub(crate) use ended::Ended;
pub(crate) use latency::{describe_quantiles, p99};
pub(crate) use log::{LogDestination, start_log};
pub(crate) use peer_wait::{PeerWait, PipelineActivity};
pub(crate) use progress::Progress;
pub(crate) use remark::remark;
pub(crate) use signals::Signals;
pub(crate) use tables::tables;

use std::sync::Arc;
use std::time::Duration;

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use crate::{VERSION, clock};
use anyhow::{Context, anyhow};
use peernet_agent::{Agent, AgentConfig, IdentityError, RunningAgent, StartError};
use peernet_clock::SharedClock;
use peernet_stream::Event;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Capacity of the channel of events from the agent, each of which is processed at once.
const EVENTS: usize = 16_384;
/// Time between two reads of the agent's state.
const POLL_INTERVAL: Duration = Duration::from_millis(250);

/// Observer of an agent in the foreground.
pub(crate) trait RunObserver {
    /// Reasons to end besides those of [`Ended`].
    type OwnReason;

    /// Processes an event. Returns a reason if the agent is to end. `running` is `None` if the end was decided before.
    fn handle_event(
        &mut self,
        event: Event,
        running: Option<&RunningAgent>,
    ) -> Option<Ended<Self::OwnReason>>;

    /// Reads the agent's state, several times a second and after every answer to a peer. Returns a reason if the agent is to end.
    fn poll_state(&mut self, running: &RunningAgent) -> Option<Ended<Self::OwnReason>>;

    /// Handles the decision to end. Work in progress is still waited for.
    fn end_decided(&mut self) {}
}

/// A checked configuration with its clock.
pub(crate) struct Ready {
    config: AgentConfig,
    /// This machine's clock.
    pub(crate) truth: SharedClock,
    /// The clock that the agent reads: `truth` with the errors of `[clock_fault]`.
    pub(crate) clock: SharedClock,
}

/// Result of an observed agent.
pub(crate) struct Watched<OwnReason> {
    pub(crate) ended: Ended<OwnReason>,
    /// The agent's name.
    pub(crate) name: String,
    /// Number of events that did not fit into the channel.
    pub(crate) missed: u64,
}

impl Ready {
    /// Checks everything that the configuration names.
    ///
    /// # Errors
    /// When the clock cannot be read (69), or the configuration is wrong (78).
    pub(crate) fn new(config: AgentConfig) -> Result<Self, Failure> {
        let unavailable = |error: std::io::Error| Failure::new(Exit::Unavailable, error);
        let truth = clock::system(&config.agent.clock_identity).map_err(unavailable)?;
        let clock = clock::with_faults(&truth, config.clock_fault.as_ref()).map_err(unavailable)?;
        let problems = Agent::check(&config, &clock);
        if !problems.is_empty() {
            let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
            return Err(Failure::new(Exit::Configuration, anyhow!("{}", problems.join("\n"))));
        }
        if let Some(faults) = clock.injected_faults() {
            print_to_stderr(format_args!(
                "CLOCK FAULT INJECTION: this host's clocks are made wrong on purpose ({faults})"
            ));
        }
        Ok(Self { config, truth, clock })
    }

    /// Runs the agent until its observer ends it or a signal arrives, then waits for its end. A second signal ends the waiting for
    /// work in progress.
    ///
    /// # Errors
    /// When the agent cannot start (69) or loses a task (70).
    pub(crate) fn watch<E: RunObserver>(self, observer: &mut E) -> Result<Watched<E::OwnReason>, Failure> {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_name("peernet").enable_all().build();
        let runtime = runtime
            .context("cannot start the threads of the runtime")
            .map_err(|error| Failure::new(Exit::Unavailable, error))?;
        let watched = runtime.block_on(watch(self.config, &self.clock, observer));
        // A thread that computes for minutes is not waited for.
        runtime.shutdown_background();
        watched
    }
}

/// Rewords the error of a start for users who have no `[agent] state_dir` to change.
fn not_started(error: StartError) -> anyhow::Error {
    match error {
        StartError::Identity(IdentityError::InUse(folder)) => anyhow!(
            "another peernet process runs as the host whose id is in {}; wait for it, stop it, or choose another name",
            folder.display()
        ),
        error => error.into(),
    }
}

async fn watch<E: RunObserver>(
    config: AgentConfig,
    clock: &SharedClock,
    observer: &mut E,
) -> Result<Watched<E::OwnReason>, Failure> {
    let mut signals = Signals::new().map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let (stop, (tap, mut events)) = (CancellationToken::new(), mpsc::channel(EVENTS));
    let running = Agent::start_with_tap(config, VERSION, Arc::clone(clock), stop.clone(), tap).await;
    let running = running.map_err(|error| Failure::new(Exit::Unavailable, not_started(error)))?;
    let name = running.name().to_string();
    let mut served = running.served_counts();
    let mut poll = tokio::time::interval(POLL_INTERVAL);
    let mut is_interrupted = false;
    let ended = loop {
        let ended = tokio::select! {
            () = signals.next() => {
                is_interrupted = true;
                Some(Ended::Interrupted)
            }
            event = events.recv() => match event {
                Some(event) => observer.handle_event(event, Some(&running)),
                None => Some(Ended::Failed("the agent ended by itself".to_owned())),
            },
            Ok(()) = served.changed() => observer.poll_state(&running),
            _ = poll.tick() => observer.poll_state(&running),
        };
        if let Some(ended) = ended {
            break ended;
        }
    };
    observer.end_decided();
    if is_interrupted {
        print_to_stderr("stopping; work in progress may take some seconds, press Ctrl-C again to abandon it");
    }
    stop.cancel();
    let missed = running.events_missed_by_tap();
    tokio::select! {
        joined = running.join() => joined.map_err(|error| Failure::new(Exit::Software, error))?,
        () = signals.next() => print_to_stderr("work in progress was abandoned"),
    }
    // Events of work that was in progress at the end.
    while let Ok(event) = events.try_recv() {
        observer.handle_event(event, None);
    }
    Ok(Watched { ended, name, missed })
}
