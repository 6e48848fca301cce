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

/// A running agent with its stop token and its state directory.
pub(crate) struct TestAgent {
    pub(crate) running: RunningAgent,
    stop: CancellationToken,
    /// The state directory, which is deleted after the last agent that uses it.
    state: StateDir,
}

/// A state directory, which may outlive an agent.
pub(crate) type StateDir = Arc<TempDir>;

/// Returns this machine's clock under a name.
pub(crate) fn clock(name: &str) -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::from_system(name).expect("linux has a boot id")))
}

/// Returns this machine's clock under a name, with injected faults.
pub(crate) fn faulty_clock(name: &str, faults: ClockFaults) -> SharedClock {
    let system = clock(name);
    let identity = system.identity().clone();
    Arc::new(FaultyClock::new(system, identity, faults))
}

/// Returns the configuration of these tables. [`TestAgent`] sets the name, the state directory and the aggregator.
pub(crate) fn config(tables: &str) -> AgentConfig {
    toml::from_str(tables).unwrap_or_else(|error| panic!("{error}\n{tables}"))
}

impl TestAgent {
    /// Starts an agent on the system's clock.
    pub(crate) async fn start(name: &str, aggregator: Option<&str>, tables: &str) -> Self {
        Self::start_with_clock_name(name, aggregator, config(tables), "system").await
    }

    /// Starts an agent on this machine's clock under the name `clock_name`. Agents whose clocks have different names
    /// relate their clocks like two hosts.
    pub(crate) async fn start_with_clock_name(
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

    /// Starts the agent `edge` on the system's clock with a state directory, which an earlier agent may have used.
    pub(crate) async fn start_in(state: StateDir, aggregator: &str, config: AgentConfig) -> Self {
        Self::try_start(clock("system"), "edge", Some(aggregator), config, state).await.expect("starts")
    }

    /// Starts an agent on this clock with a state directory. Returns an error if the start fails.
    pub(crate) async fn try_start(
        clock: SharedClock,
        name: &str,
        aggregator: Option<&str>,
        mut config: AgentConfig,
        state: StateDir,
    ) -> Result<Self, StartError> {
        config.agent.name = Some(name.parse().expect("a name"));
        config.agent.state_dir = state.path().to_owned();
        config.agent.aggregator = aggregator.map(|address| address.parse().expect("an address"));
        let stop = CancellationToken::new();
        let running = Agent::start(config, VERSION, clock, stop.clone()).await?;
        Ok(Self { running, stop, state })
    }

    /// Returns the path of the agent's spool.
    pub(crate) fn spool(&self) -> PathBuf {
        self.state.path().join("spool.sqlite")
    }

    /// Returns the first address at which the agent serves.
    pub(crate) fn address(&self) -> String {
        self.running.serve_addresses().first().expect("the agent serves").to_string()
    }

    /// Returns the live state of the agent's only pipeline.
    pub(crate) fn pipeline(&self) -> PipelineLive {
        self.running.live_update().pipelines.pop().expect("the agent has a pipeline")
    }

    /// Waits until the state of the agent's only pipeline satisfies a condition. Returns the state.
    pub(crate) async fn until_state(&self, condition: impl Fn(&PipelineState) -> bool) -> PipelineState {
        let live = self.until(|live| condition(&live.pipelines[0].state)).await;
        live.pipelines.into_iter().map(|pipeline| pipeline.state).next().expect("the agent has a pipeline")
    }

    /// Waits until the agent's live update satisfies a condition. Returns the update.
    // The update is polled, because changes are not announced.
    pub(crate) async fn until(&self, condition: impl Fn(&LiveUpdate) -> bool) -> LiveUpdate {
        let checks = async {
            loop {
                let live = self.running.live_update();
                if condition(&live) {
                    return live;
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        match tokio::time::timeout(WAIT_TIMEOUT, checks).await {
            Ok(live) => live,
            Err(_) => panic!("the condition was not met in time: {:?}", self.running.live_update()),
        }
    }

    /// Stops the agent as at a regular end of the process.
    pub(crate) async fn stop(self) -> Result<(), Failure> {
        self.stop_and_keep().await.map(drop)
    }

    /// Stops the agent as at a regular end of the process, and returns the state directory.
    pub(crate) async fn stop_and_keep(self) -> Result<StateDir, Failure> {
        self.stop.cancel();
        tokio::time::timeout(WAIT_TIMEOUT, self.running.join()).await.expect("stops in time")?;
        Ok(self.state)
    }

    /// Ends the agent like a crash: without a goodbye, and without completing the iterations in flight.
    pub(crate) fn kill(self) {
        drop(self.running);
    }

    /// Ends the agent like a crash, and waits until the state directory and the spool are unlocked. Returns the state
    /// directory.
    // A child process that is just being started, such as `chronyc`, holds the locks of the agent until the child
    // executes its program.
    pub(crate) async fn crash(self) -> StateDir {
        let locks = ["lock", "spool.sqlite-lock"].map(|name| self.state.path().join(name));
        drop(self.running);
        let free = tokio::task::spawn_blocking(move || {
            for lock in locks {
                let file = std::fs::File::open(lock).expect("the agent had a state directory and a spool");
                file.lock().expect("the lock becomes free");
            }
        });
        tokio::time::timeout(WAIT_TIMEOUT, free)
            .await
            .expect("the locks become free in time")
            .expect("no panic");
        self.state
    }
}
