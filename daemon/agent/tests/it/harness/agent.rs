//! An agent in this process.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use peernet_agent::{Agent, AgentConfig, Failure, Running, StartError};
use peernet_clock::{ClockFaults, ClockIdentity, FaultyClock, SharedClock, SystemClock};
use peernet_stream::{LiveUpdate, PipelineLive, PipelineState};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use super::{PATIENCE, VERSION};

/// An agent and what it needs.
pub(crate) struct TestAgent {
    pub(crate) running: Running,
    stop: CancellationToken,
    /// Goes with the agents that use it.
    state: State,
}

/// The folder that outlives an agent.
pub(crate) type State = Arc<TempDir>;

/// This machine's clock under a name.
pub(crate) fn clock(name: &str) -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::of_this_machine(name).expect("linux has a boot id")))
}

/// This machine's clock under a name of its own, made wrong.
pub(crate) fn rehearsed(name: &str, wrong: ClockFaults) -> SharedClock {
    let system = clock(name);
    let identity = system.identity().clone();
    Arc::new(FaultyClock::new(system, identity, wrong))
}

/// A configuration of these tables, without `[agent]`.
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

    /// Starts an agent on the system's clock in a folder that another one may have left.
    pub(crate) async fn start_in(state: State, aggregator: &str, config: AgentConfig) -> Self {
        Self::try_start(clock("system"), "edge", Some(aggregator), config, state).await.expect("starts")
    }

    /// As [`start_in`](Self::start_in), where it may be refused.
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

    /// Its spool's file.
    pub(crate) fn spool(&self) -> PathBuf {
        self.state.path().join("spool.sqlite")
    }

    /// Where it serves.
    pub(crate) fn address(&self) -> String {
        self.running.serves().first().expect("it serves").to_string()
    }

    /// Its only pipeline.
    pub(crate) fn pipeline(&self) -> PipelineLive {
        self.running.live().pipelines.pop().expect("it has a pipeline")
    }

    /// Waits until its only pipeline is in such a state.
    pub(crate) async fn until_state(&self, wanted: impl Fn(&PipelineState) -> bool) -> PipelineState {
        let live = self.until(|live| wanted(&live.pipelines[0].state)).await;
        live.pipelines.into_iter().map(|pipeline| pipeline.state).next().expect("it has a pipeline")
    }

    /// Waits until it shows itself so. It is looked at again and again: nothing tells of a change.
    pub(crate) async fn until(&self, wanted: impl Fn(&LiveUpdate) -> bool) -> LiveUpdate {
        let looks = async {
            loop {
                let live = self.running.live();
                if wanted(&live) {
                    return live;
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        match tokio::time::timeout(PATIENCE, looks).await {
            Ok(live) => live,
            Err(_) => panic!("never came: {:?}", self.running.live()),
        }
    }

    /// Stops it as the process would.
    pub(crate) async fn stop(self) -> Result<(), Failure> {
        self.stop_and_keep().await.map(drop)
    }

    /// The same; what it leaves behind stays.
    pub(crate) async fn stop_and_keep(self) -> Result<State, Failure> {
        self.stop.cancel();
        tokio::time::timeout(PATIENCE, self.running.join()).await.expect("stops in time")?;
        Ok(self.state)
    }

    /// Ends it as a crash would: nothing is said, nothing finished.
    pub(crate) fn kill(self) {
        drop(self.running);
    }

    /// The same, and waits until its folder and its spool are free: a child that is being started, such as `chronyc`,
    /// holds the locks of its parent until it becomes another program.
    pub(crate) async fn crash(self) -> State {
        let locks = ["lock", "spool.sqlite-lock"].map(|name| self.state.path().join(name));
        drop(self.running);
        let free = tokio::task::spawn_blocking(move || {
            for lock in locks {
                let file = std::fs::File::open(lock).expect("it had a folder and a spool");
                file.lock().expect("becomes free");
            }
        });
        tokio::time::timeout(PATIENCE, free).await.expect("ends in time").expect("no panic");
        self.state
    }
}
