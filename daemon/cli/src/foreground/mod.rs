//! An agent in the foreground: started, watched until it is done or somebody ends it, and seen to its end.
//!
//! Three commands run one: `calibrate` studies a link, `measure` takes a run down, and the published `--server` serves.
//! They differ in what they look for ([`RunObserver`]); starting, signals and stopping are the same.

mod dashboard;
mod ended;
mod latency;
mod log;
mod peer_wait;
mod progress;
mod remark;
mod signals;
mod tables;
mod typed;
mod waiting;

pub(crate) use dashboard::where_seen;
pub(crate) use ended::Ended;
pub(crate) use latency::{p99, told};
pub(crate) use log::{Shows, listen};
pub(crate) use peer_wait::{PeerWait, PipelineActivity};
pub(crate) use progress::Progress;
pub(crate) use remark::remark;
pub(crate) use signals::Signals;
pub(crate) use tables::tables;
pub(crate) use typed::typed;
pub(crate) use waiting::duration;

use std::sync::Arc;
use std::time::Duration;

use crate::exit::{Exit, Failure};
use crate::output::complain;
use crate::{VERSION, clock};
use anyhow::{Context, anyhow};
use peernet_agent::{Agent, AgentConfig, IdentityError, Running, StartError};
use peernet_clock::SharedClock;
use peernet_stream::Event;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Events between the agent and this program, which looks at each at once.
const EVENTS: usize = 16_384;
/// Between two looks at the agent.
const LOOK: Duration = Duration::from_millis(250);

/// Looks at an agent in the foreground.
pub(crate) trait RunObserver {
    /// How it can end beside what [`Ended`] names.
    type Own;

    /// Takes an event; says how it ended if it did. Without `running` the end was decided before.
    fn take(&mut self, event: Event, running: Option<&Running>) -> Option<Ended<Self::Own>>;

    /// Looks at the agent, several times a second and after every answer to a peer; says whether it is over.
    fn look(&mut self, running: &Running) -> Option<Ended<Self::Own>>;

    /// It is over; what is under way is still waited for.
    fn over(&mut self) {}
}

/// A checked configuration and the clock that it runs by.
pub(crate) struct Ready {
    config: AgentConfig,
    /// This machine's clock.
    pub(crate) truth: SharedClock,
    /// What `[rehearsal]` makes of it.
    pub(crate) clock: SharedClock,
}

/// What came of it.
pub(crate) struct Watched<Own> {
    pub(crate) ended: Ended<Own>,
    /// The agent's name.
    pub(crate) name: String,
    /// Events that there was no room for.
    pub(crate) missed: u64,
}

impl Ready {
    /// Checks everything that the configuration names.
    ///
    /// # Errors
    /// When the clock cannot be read (69), or something is wrong with the configuration (78).
    pub(crate) fn new(config: AgentConfig) -> Result<Self, Failure> {
        let unavailable = |error: std::io::Error| Failure::new(Exit::Unavailable, error);
        let truth = clock::system(&config.agent.clock_identity).map_err(unavailable)?;
        let clock = clock::rehearsed(&truth, config.rehearsal.as_ref()).map_err(unavailable)?;
        let problems = Agent::check(&config, &clock);
        if !problems.is_empty() {
            let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
            return Err(Failure::new(Exit::Configuration, anyhow!("{}", problems.join("\n"))));
        }
        if let Some(rehearsal) = clock.rehearsal() {
            complain(format_args!("REHEARSAL: this host's clocks are made wrong on purpose ({rehearsal})"));
        }
        Ok(Self { config, truth, clock })
    }

    /// Runs the agent until its observer has seen enough or a signal arrives, then waits for its end. A second signal ends
    /// the waiting for what is under way.
    ///
    /// # Errors
    /// When the agent cannot start (69) or loses a task (70).
    pub(crate) fn watch<E: RunObserver>(self, observer: &mut E) -> Result<Watched<E::Own>, Failure> {
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

/// Why the agent did not start, for those who have no `[agent] state_dir` to change.
fn not_started(error: StartError) -> anyhow::Error {
    match error {
        StartError::Identity(IdentityError::InUse(folder)) => anyhow!(
            "another peernet is at work as the host that keeps its id in {}; wait for it or end it, or take another name",
            folder.display()
        ),
        error => error.into(),
    }
}

async fn watch<E: RunObserver>(
    config: AgentConfig,
    clock: &SharedClock,
    observer: &mut E,
) -> Result<Watched<E::Own>, Failure> {
    let mut signals = Signals::new().map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let (stop, (tap, mut events)) = (CancellationToken::new(), mpsc::channel(EVENTS));
    let running = Agent::start_observed(config, VERSION, Arc::clone(clock), stop.clone(), tap).await;
    let running = running.map_err(|error| Failure::new(Exit::Unavailable, not_started(error)))?;
    let name = running.name().to_string();
    let mut served = running.served();
    let mut look = tokio::time::interval(LOOK);
    let mut is_interrupted = false;
    let ended = loop {
        let ended = tokio::select! {
            () = signals.next() => {
                is_interrupted = true;
                Some(Ended::Interrupted)
            }
            event = events.recv() => match event {
                Some(event) => observer.take(event, Some(&running)),
                None => Some(Ended::Failed("the agent ended by itself".to_owned())),
            },
            Ok(()) = served.changed() => observer.look(&running),
            _ = look.tick() => observer.look(&running),
        };
        if let Some(ended) = ended {
            break ended;
        }
    };
    observer.over();
    if is_interrupted {
        complain("ending; what is under way may take some seconds, Ctrl-C again does not wait for it");
    }
    stop.cancel();
    let missed = running.untapped();
    tokio::select! {
        joined = running.join() => joined.map_err(|error| Failure::new(Exit::Software, error))?,
        () = signals.next() => complain("what was under way is left alone"),
    }
    // What was under way when it ended.
    while let Ok(event) = events.try_recv() {
        observer.take(event, None);
    }
    Ok(Watched { ended, name, missed })
}
