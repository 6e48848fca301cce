//! An aggregator and agents that measure on their own, all of which can be stopped, killed and started again.

use std::path::{Path, PathBuf};

use peernet_clock::WallTime;

use crate::spooled::TELLS_SPOOLED;
use crate::{Account, Api, Daemon, Ledger, Site, until, wall};

/// One site's daemons.
#[derive(Debug)]
pub struct Fleet {
    /// Their files and ports.
    pub site: Site,
    /// The dashboard.
    pub api: Api,
    /// The aggregator.
    pub aggregator: Daemon,
    /// The agents.
    pub agents: Vec<Daemon>,
    database: PathBuf,
}

/// The usual place of the database, as [`Site::write`] takes it.
const DATABASE: &str = "{folder}/store/aggregator.sqlite";

/// The configuration of an agent that says what it spooled: further keys of `[agent]`, and further tables.
pub fn edge(keys: &str, tables: &str) -> String {
    edge_in("{folder}/NAME", keys, tables)
}

/// The same with another folder for its state.
pub fn edge_in(state: &str, keys: &str, tables: &str) -> String {
    format!(
        "[log]\nlevel = \"{TELLS_SPOOLED}\"\n\
         [agent]\nname = \"NAME\"\nstate_dir = \"{state}\"\naggregator = \"tcp://127.0.0.1:{{events}}\"\n{keys}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n{tables}"
    )
}

/// A pipeline that echoes small payloads on its own host; `more` are further keys, such as the load. Without one it
/// goes as fast as it can.
pub fn echo(name: &str, more: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"{name}\"\nsensor = {{ kind = \"synthetic\", size_bytes = 64 }}\n\
         placement = {{ kind = \"local\", model = \"echo\" }}\n{more}\n"
    )
}

/// Keys of a pipeline that begins so many iterations a second.
pub fn rate(hz: f64) -> String {
    format!("load = {{ mode = \"rate\", hz = {hz:?} }}")
}

impl Fleet {
    /// An aggregator that runs, and agents that do not yet, with one configuration.
    pub fn new(agents: &[&str], configuration: &str) -> Self {
        Self::storing_in(DATABASE, agents, configuration)
    }

    /// The same with the database in another folder.
    pub fn storing_in(database: &str, agents: &[&str], configuration: &str) -> Self {
        Self::with(database, "", agents, configuration)
    }

    /// The same with further keys of `[aggregator]`.
    pub fn aggregating(keys: &str, agents: &[&str], configuration: &str) -> Self {
        Self::with(DATABASE, keys, agents, configuration)
    }

    fn with(database: &str, keys: &str, agents: &[&str], configuration: &str) -> Self {
        let site = Site::new();
        let tables = format!(
            "[aggregator]\nname = \"aggregator\"\nlisten = \"tcp://127.0.0.1:{{events}}\"\n\
             database = \"{database}\"\n{keys}\n[web]\nlisten = \"127.0.0.1:{{http}}\"\n"
        );
        let aggregator = Daemon::started(&site, "aggregator", &tables);
        let agents = agents.iter().map(|name| Daemon::new(&site, name, configuration)).collect();
        let database = database.replace("{folder}", &site.folder().display().to_string());
        let fleet = Self { api: Api::at(site.http), site, aggregator, agents, database: database.into() };
        fleet.answers();
        fleet
    }

    /// Waits until the aggregator answers.
    pub fn answers(&self) {
        until("the dashboard", || self.api.get("/healthz").filter(|(status, _)| *status == 200));
    }

    /// Starts the aggregator again and waits until it answers.
    pub fn aggregator_returns(&mut self) {
        self.aggregator.start(&self.site);
        self.answers();
    }

    /// Starts an agent.
    pub fn start(&mut self, agent: usize) {
        self.agents[agent].start(&self.site);
    }

    /// Starts all agents.
    pub fn start_all(&mut self) {
        (0..self.agents.len()).for_each(|agent| self.start(agent));
    }

    /// Waits until the account of an agent is as `holds` says.
    pub fn account(&self, agent: usize, what: &str, holds: impl FnMut(&Account) -> bool) -> Account {
        Account::until(&self.api, &self.agents[agent].name, what, holds)
    }

    /// Starts an agent without its pipelines and waits until the aggregator has taken it in. Returns when that was: the
    /// picture may still show its last life.
    pub fn idle(&mut self, agent: usize) -> WallTime {
        self.agents[agent].start_idle(&self.site);
        self.agents[agent].process().wait_for("connected to the aggregator");
        wall()
    }

    /// The same, and waits until what its spool held is stored. It keeps running.
    pub fn deliver(&mut self, agent: usize) -> Account {
        let since = self.idle(agent);
        Account::at_rest(&self.api, &self.agents[agent].name, since)
    }

    /// The database's file.
    pub fn database(&self) -> &Path {
        &self.database
    }

    /// What is stored now; checked to agree with itself. Best asked when the aggregator has stopped.
    pub fn ledger(&self) -> Ledger {
        let ledger = Ledger::of(&self.database);
        ledger.agrees();
        ledger
    }

    /// Stops what runs; every process must end well. Returns what is stored.
    pub fn stop(&mut self) -> Ledger {
        for agent in self.agents.iter_mut().filter(|agent| agent.runs()) {
            agent.stop();
        }
        self.aggregator.stop();
        self.ledger()
    }
}
