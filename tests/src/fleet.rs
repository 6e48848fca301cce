//! An aggregator and agents, all of which can be stopped, killed and restarted.

use std::path::{Path, PathBuf};

use peernet_clock::WallTime;

use crate::spooled_iterations::SPOOL_LOG_LEVEL;
use crate::{Api, Daemon, EventCounts, LoopbackDeployment, StoredEvents, wait_until, wall};

/// Daemons of one test: an aggregator and agents that measure independently.
#[derive(Debug)]
pub struct Fleet {
    /// Files and ports of the test.
    pub deployment: LoopbackDeployment,
    /// Client of the REST API.
    pub api: Api,
    /// The aggregator.
    pub aggregator: Daemon,
    /// The agents.
    pub agents: Vec<Daemon>,
    database: PathBuf,
}

/// Default path of the database, as a template for [`LoopbackDeployment::write`].
const DEFAULT_DATABASE: &str = "{folder}/store/aggregator.sqlite";

/// Returns the configuration of an agent that logs its spooled batches, with additional keys of `[agent]` and
/// additional tables.
pub fn agent_configuration(keys: &str, tables: &str) -> String {
    agent_configuration_in("{folder}/NAME", keys, tables)
}

/// Returns the configuration of [`agent_configuration`] with another state folder.
pub fn agent_configuration_in(state: &str, keys: &str, tables: &str) -> String {
    format!(
        "[log]\nlevel = \"{SPOOL_LOG_LEVEL}\"\n\
         [agent]\nname = \"NAME\"\nstate_dir = \"{state}\"\naggregator = \"tcp://127.0.0.1:{{events}}\"\n{keys}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n{tables}"
    )
}

/// Returns the table of a pipeline that echoes small payloads on its own host. `keys` are additional keys, such as the
/// load; without a load the pipeline is a closed loop.
pub fn echo_pipeline(name: &str, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"{name}\"\nsensor = {{ kind = \"synthetic\", size_bytes = 64 }}\n\
         placement = {{ kind = \"local\", model = \"echo\" }}\n{keys}\n"
    )
}

/// Returns the keys of a pipeline with this number of iterations per second.
pub fn rate_load(hz: f64) -> String {
    format!("load = {{ mode = \"rate\", hz = {hz:?} }}")
}

impl Fleet {
    /// Starts an aggregator, and writes the same configuration for all agents without starting them.
    pub fn new(agents: &[&str], configuration: &str) -> Self {
        Self::with_database(DEFAULT_DATABASE, agents, configuration)
    }

    /// Creates the fleet with the database at another path.
    pub fn with_database(database: &str, agents: &[&str], configuration: &str) -> Self {
        Self::with_options(database, "", agents, configuration)
    }

    /// Creates the fleet with additional keys of `[aggregator]`.
    pub fn with_aggregator_keys(keys: &str, agents: &[&str], configuration: &str) -> Self {
        Self::with_options(DEFAULT_DATABASE, keys, agents, configuration)
    }

    fn with_options(database: &str, keys: &str, agents: &[&str], configuration: &str) -> Self {
        let deployment = LoopbackDeployment::new();
        let tables = format!(
            "[aggregator]\nname = \"aggregator\"\nlisten = \"tcp://127.0.0.1:{{events}}\"\n\
             database = \"{database}\"\n{keys}\n[web]\nlisten = \"127.0.0.1:{{http}}\"\n"
        );
        let aggregator = Daemon::start_new(&deployment, "aggregator", &tables);
        let agents = agents.iter().map(|name| Daemon::new(&deployment, name, configuration)).collect();
        let database = database.replace("{folder}", &deployment.folder().display().to_string());
        let fleet = Self {
            api: Api::on_port(deployment.http_port),
            deployment,
            aggregator,
            agents,
            database: database.into(),
        };
        fleet.wait_until_ready();
        fleet
    }

    /// Waits until the aggregator answers.
    pub fn wait_until_ready(&self) {
        wait_until("the dashboard", || self.api.get("/healthz").filter(|(status, _)| *status == 200));
    }

    /// Starts the aggregator again and waits until it answers.
    pub fn restart_aggregator(&mut self) {
        self.aggregator.start(&self.deployment);
        self.wait_until_ready();
    }

    /// Starts an agent.
    pub fn start(&mut self, agent: usize) {
        self.agents[agent].start(&self.deployment);
    }

    /// Starts all agents.
    pub fn start_all(&mut self) {
        (0..self.agents.len()).for_each(|agent| self.start(agent));
    }

    /// Waits until the counts of an agent fulfil `condition`.
    pub fn wait_for_counts(
        &self,
        agent: usize,
        description: &str,
        condition: impl FnMut(&EventCounts) -> bool,
    ) -> EventCounts {
        EventCounts::wait_until(&self.api, &self.agents[agent].name, description, condition)
    }

    /// Starts an agent without its pipelines and waits until it is connected to the aggregator. Returns the time of the
    /// connection. Until then the live state may describe the previous process.
    pub fn start_without_pipelines(&mut self, agent: usize) -> WallTime {
        self.agents[agent].start_without_pipelines(&self.deployment);
        self.agents[agent].process().wait_for("connected to the aggregator");
        wall()
    }

    /// Starts an agent without its pipelines, and waits until the contents of its spool are stored. The agent continues to
    /// run.
    pub fn deliver_spool(&mut self, agent: usize) -> EventCounts {
        let since = self.start_without_pipelines(agent);
        EventCounts::wait_until_at_rest(&self.api, &self.agents[agent].name, since)
    }

    /// Returns the path of the database.
    pub fn database(&self) -> &Path {
        &self.database
    }

    /// Returns the stored data, and asserts that it is consistent. Call it after the aggregator has stopped, if possible.
    pub fn stored_events(&self) -> StoredEvents {
        let stored_events = StoredEvents::read(&self.database);
        stored_events.assert_consistent();
        stored_events
    }

    /// Stops all running processes, each of which must exit with 0. Returns the stored data.
    pub fn stop(&mut self) -> StoredEvents {
        for agent in self.agents.iter_mut().filter(|agent| agent.is_running()) {
            agent.stop();
        }
        self.aggregator.stop();
        self.stored_events()
    }
}
