//! Running of an agent in the foreground: the agent is started, observed until it is done or a signal arrives, and
//! stopped.
//!
//! Three commands use this module: `calibrate` studies a link, `measure` records a run, and the paper's `--server`
//! serves. The commands differ in their observer ([`RunObserver`]); starting, signals and stopping are the same. Events
//! come from the agent's tap, a channel to which the agent copies every event. The rest of the agent's state is read
//! several times a second.

mod agent_end;
mod command_line;
mod condition;
mod dashboard;
mod duration;
mod latency;
mod log;
mod peer_wait;
mod progress;
mod tables;

pub(crate) use crate::shutdown_signals::Signals;
pub(crate) use agent_end::AgentEnd;
pub(crate) use command_line::command_line;
pub(crate) use condition::describe_condition;
pub(crate) use dashboard::dashboard_hint;
pub(crate) use duration::{estimated_duration, long_duration};
pub(crate) use latency::describe_quantiles;
pub(crate) use log::{LogDestination, start_log};
pub(crate) use peer_wait::{PeerWait, PipelineActivity};
pub(crate) use progress::Progress;
pub(crate) use tables::read_agent_tables;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use crate::{VERSION, clock};
use anyhow::{Context, anyhow};
use peernet_agent::{Agent, AgentConfig, IdentityError, REMARK_LOG_TARGET, RunningAgent, StartError};
use peernet_clock::SharedClock;
use peernet_statistics::number::counted;
use peernet_stream::Event;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Capacity of the channel of events from the agent. Events are processed as soon as they arrive, so
/// that the channel fills up only on a machine that is too busy.
const EVENT_CAPACITY: usize = 16_384;
/// Time between two reads of the agent's state.
const POLL_INTERVAL: Duration = Duration::from_millis(250);

/// Observer of an agent in the foreground.
pub(crate) trait RunObserver {
    /// Reasons to end besides those of [`AgentEnd`].
    type OwnReason;

    /// Processes an event. Returns a reason if the agent is to end. `running` is `None` for events that are left
    /// after the agent has ended.
    fn handle_event(
        &mut self,
        event: Event,
        running: Option<&RunningAgent>,
    ) -> Option<AgentEnd<Self::OwnReason>>;

    /// Reads the agent's state. This method is called several times a second and after every answer to a peer. Returns
    /// a reason if the agent is to end.
    fn poll_state(&mut self, running: &RunningAgent) -> Option<AgentEnd<Self::OwnReason>>;

    /// Handles the decision to end. Work in progress is still waited for.
    fn end_decided(&mut self) {}
}

/// A checked configuration of an agent, with its clocks.
pub(crate) struct ReadyAgent {
    config: AgentConfig,
    /// This machine's clock.
    pub(crate) system_clock: SharedClock,
    /// The clock that the agent reads: `system_clock` with the errors of `[clock_fault]`.
    pub(crate) clock: SharedClock,
    /// Folder to which the command writes results, if any.
    pub(crate) results_dir: Option<PathBuf>,
}

/// Result of an agent that has ended.
pub(crate) struct AgentResult<OwnReason> {
    pub(crate) end: AgentEnd<OwnReason>,
    /// The agent's name.
    pub(crate) name: String,
    /// Number of iterations that did not fit into the channel of events.
    pub(crate) missed_iterations: u64,
}

/// Longest wait for threads that block, when the program ends.
const BLOCKING_THREADS_TIMEOUT: Duration = Duration::from_secs(1);

impl ReadyAgent {
    /// Checks the configuration and everything that it names, and creates the clocks.
    ///
    /// # Errors
    /// When the clock cannot be read (exit code 69), or the configuration is wrong (exit code 78).
    pub(crate) fn new(config: AgentConfig) -> Result<Self, Failure> {
        let unavailable = |error: std::io::Error| Failure::new(Exit::Unavailable, error);
        let system_clock = clock::system(&config.agent.clock_identity).map_err(unavailable)?;
        let clock = clock::with_faults(&system_clock, config.clock_fault.as_ref()).map_err(unavailable)?;
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
        Ok(Self { config, system_clock, clock, results_dir: None })
    }

    /// Runs the agent until its observer ends it or a signal arrives, then waits for its end. A second signal ends
    /// the waiting for work in progress.
    ///
    /// # Errors
    /// When the agent cannot start (exit code 69) or loses a task (exit code 70).
    pub(crate) fn watch<O: RunObserver>(
        self,
        observer: &mut O,
    ) -> Result<AgentResult<O::OwnReason>, Failure> {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_name("peernet").enable_all().build();
        let runtime = runtime
            .context("cannot start the threads of the runtime")
            .map_err(|error| Failure::new(Exit::Unavailable, error))?;
        let result = runtime.block_on(watch(self.config, &self.clock, self.results_dir, observer));
        // The threads that end the programs of sensors and actuators are waited for, but not a thread that computes for
        // minutes.
        runtime.shutdown_timeout(BLOCKING_THREADS_TIMEOUT);
        result
    }
}

/// Rewords the error of a start for users who have no `[agent] state_dir` to change.
fn describe_start_error(error: StartError) -> anyhow::Error {
    match error {
        StartError::Identity(IdentityError::InUse(folder)) => anyhow!(
            "another peernet process runs as the host whose id is in {}; wait for it, stop it, or choose another name",
            folder.display()
        ),
        error => error.into(),
    }
}

async fn watch<O: RunObserver>(
    config: AgentConfig,
    clock: &SharedClock,
    results_dir: Option<PathBuf>,
    observer: &mut O,
) -> Result<AgentResult<O::OwnReason>, Failure> {
    let mut signals = Signals::new().map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let (stop, (tap, mut events)) = (CancellationToken::new(), mpsc::channel(EVENT_CAPACITY));
    let running =
        Agent::start_with_tap(config, VERSION, Arc::clone(clock), stop.clone(), tap, results_dir).await;
    let mut running =
        running.map_err(|error| Failure::new(Exit::Unavailable, describe_start_error(error)))?;
    let name = running.name().to_string();
    let mut served_counts = running.served_counts();
    let mut poll = tokio::time::interval(POLL_INTERVAL);
    let mut is_interrupted = false;
    let end = loop {
        let end = tokio::select! {
            _ = signals.next() => {
                is_interrupted = true;
                Some(AgentEnd::Interrupted)
            }
            Some(event) = events.recv() => observer.handle_event(event, Some(&running)),
            () = running.wait_for_failure() => Some(AgentEnd::Failed("a part of the agent failed".to_owned())),
            // With this branch, a server ends at its last answer and not up to a `POLL_INTERVAL` later.
            Ok(()) = served_counts.changed() => observer.poll_state(&running),
            _ = poll.tick() => observer.poll_state(&running),
        };
        if let Some(end) = end {
            break end;
        }
    };
    observer.end_decided();
    if is_interrupted {
        print_to_stderr("stopping; work in progress may take some seconds, press Ctrl-C again to abandon it");
    }
    stop.cancel();
    // Joining consumes the agent, so the counters are taken before.
    let missed_event_counters = running.missed_event_counters();
    let join_result = tokio::select! {
        result = running.join() => result,
        _ = signals.next() => {
            print_to_stderr("work in progress was abandoned");
            Ok(())
        }
    };
    // Read after the join, because events of work in progress may not fit into the channel either.
    let missed_events = missed_event_counters.read();
    if missed_events.others > 0 {
        // Missed iterations are missing measurements. The command reports them with its results.
        tracing::warn!(
            target: REMARK_LOG_TARGET,
            "{} other than iterations did not arrive here: this machine is too busy",
            counted(missed_events.others, "event")
        );
    }
    // Events of work that was in progress at the end, also if the agent failed: they are measurements.
    while let Ok(event) = events.try_recv() {
        observer.handle_event(event, None);
    }
    join_result.map_err(|error| Failure::new(Exit::Software, error))?;
    Ok(AgentResult { end, name, missed_iterations: missed_events.iterations })
}
