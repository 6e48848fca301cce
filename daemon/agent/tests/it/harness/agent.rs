//! An agent in the test's process.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use peernet_agent::{Agent, AgentConfig, Failure, RunningAgent, StartError};
use peernet_clock::{ClockFaults, ClockIdentity, FaultyClock, SharedClock, SystemClock};
use peernet_stream::{LiveUpdate, PipelineLive, PipelineState};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use super::{VERSION, WAIT_TIMEOUT};

/// A running agent with its token and folder.
pub(crate) struct TestAgent {
    pub(crate) running: RunningAgent,
    stop: CancellationToken,
    /// Folder that is deleted after the last agent that uses it.
    state: State,
}

/// State directory, which may outlive an agent.
pub(crate) type State = Arc<TempDir>;

/// Returns this machine's clock under a name.
pub(crate) fn clock(name: &str) -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::from_system(name).expect("linux has a boot id")))
}

/// Returns this machine's clock under another name, with injected faults.
pub(crate) fn faulty_clock(name: &str, wrong: ClockFaults) -> SharedClock {
    let system = clock(name);
    let identity = system.identity().clone();
    Arc::new(FaultyClock::new(system, identity, wrong))
}

/// Returns the configuration of these tables, without `[agent]`.
pub(crate) fn config(tables: &str) -> AgentConfig {
    toml::from_str(tables).unwrap_or_else(|error| panic!("{error}\n{tables}"))
}

impl TestAgent {
    /// Starts an agent on the system's clock.
    pub(crate) async fn start(name: &str, aggregator: Option<&str>, tables: &str) -> Self {
        Self::start_with(name, aggregator, config(tables), "system").await
    }

    /// Starts an agent on a clock of a given name.
    pub(crate) async fn start_with(
        name: &str,
        aggregator: Option<&str>,
        config: AgentConfig,
        clock_name: &str,
    ) -> Self {
        Self::start_on(clock(clock_name), name, aggregator, config).await
    }

    /// Starts an agent on this clock.
    pub(crate) async fn start_on(
        clock: SharedClock,
        name: &str,
        aggregator: Option<&str>,
        config: AgentConfig,
    ) -> Self {
        let state = Arc::new(tempfile::tempdir().expect("a folder"));
        Self::try_start(clock, name, aggregator, config, state).await.expect("starts")
    }

    /// Starts an agent on the system's clock in the folder of an earlier agent.
    pub(crate) async fn start_in(state: State, aggregator: &str, config: AgentConfig) -> Self {
        Self::try_start(clock("system"), "edge", Some(aggregator), config, state).await.expect("starts")
    }

    /// Does the same as [`start_in`](Self::start_in), but returns an error if the start fails.
    pub(crate) async fn try_start(
        clock: SharedClock,
        name: &str,
        aggregator: Option<&str>,
        mut config: AgentConfig,
        state: State,
    ) -> Result<Self, StartError> {
        config.agent.name = Some(name.parse().expect("a name"));
        config.agent.state_dir = state.path().to_owned();
        config.agent.aggregator = aggregator.map(|address| address.parse().expect("an address"));
        let stop = CancellationToken::new();
        let running = Agent::start(config, VERSION, clock, stop.clone()).await?;
        Ok(Self { running, stop, state })
    }

    /// Returns the path of its spool.
    pub(crate) fn spool(&self) -> PathBuf {
        self.state.path().join("spool.sqlite")
    }

    /// Returns the address at which it serves.
    pub(crate) fn address(&self) -> String {
        self.running.serve_addresses().first().expect("it serves").to_string()
    }

    /// Returns the live state of its only pipeline.
    pub(crate) fn pipeline(&self) -> PipelineLive {
        self.running.live_update().pipelines.pop().expect("it has a pipeline")
    }

    /// Waits until its only pipeline is in a wanted state.
    pub(crate) async fn until_state(&self, wanted: impl Fn(&PipelineState) -> bool) -> PipelineState {
        let live = self.until(|live| wanted(&live.pipelines[0].state)).await;
        live.pipelines.into_iter().map(|pipeline| pipeline.state).next().expect("it has a pipeline")
    }

    /// Waits until its live update is as wanted. It is polled, because changes are not announced.
    pub(crate) async fn until(&self, wanted: impl Fn(&LiveUpdate) -> bool) -> LiveUpdate {
        let checks = async {
            loop {
                let live = self.running.live_update();
                if wanted(&live) {
                    return live;
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        match tokio::time::timeout(WAIT_TIMEOUT, checks).await {
            Ok(live) => live,
            Err(_) => panic!("never came: {:?}", self.running.live_update()),
        }
    }

    /// Stops it like a regular end of the process.
    pub(crate) async fn stop(self) -> Result<(), Failure> {
        self.stop_and_keep().await.map(drop)
    }

    /// Stops it like a regular end of the process, and returns its folder.
    pub(crate) async fn stop_and_keep(self) -> Result<State, Failure> {
        self.stop.cancel();
        tokio::time::timeout(WAIT_TIMEOUT, self.running.join()).await.expect("stops in time")?;
        Ok(self.state)
    }

    /// Ends it like a crash: without a goodbye and without completing anything.
    pub(crate) fn kill(self) {
        drop(self.running);
    }

    /// Ends it like a crash, and waits until its folder and its spool are unlocked: a child process that is just
    /// being started, such as `chronyc`, holds the locks of its parent until it has executed its program.
    pub(crate) async fn crash(self) -> State {
        let locks = ["lock", "spool.sqlite-lock"].map(|name| self.state.path().join(name));
        drop(self.running);
        let free = tokio::task::spawn_blocking(move || {
            for lock in locks {
                let file = std::fs::File::open(lock).expect("it had a folder and a spool");
                file.lock().expect("becomes free");
            }
        });
        tokio::time::timeout(WAIT_TIMEOUT, free).await.expect("ends in time").expect("no panic");
        self.state
    }
}
