//! An edge and a cloud in a network of namespaces, which report to an aggregator outside of it.

use std::path::{Path, PathBuf};

use peernet_clock::{Clock, ClockIdentity, RawTime, Span, Stamp, SystemClock, WallTime};

use crate::loopback_deployment::agent_table;
use crate::network::Host;
use crate::truth::{HostClock, Iteration, iterations, query_database};
use crate::{Api, LoopbackDeployment, Network, Process, program};

/// Returns the times of the kernel's clocks.
fn stamp() -> Stamp {
    SystemClock::new(ClockIdentity::new("boot", "system")).stamp()
}

/// Two hosts and an aggregator. The network is dropped last.
#[derive(Debug)]
pub struct TwoHostTestbed {
    /// Client of the REST API.
    pub api: Api,
    aggregator: Process,
    deployment: LoopbackDeployment,
    /// Scheme of the address at which the cloud serves.
    scheme: &'static str,
    /// Network between the hosts.
    pub network: Network,
    /// Times of the kernel's clocks before a host was started.
    start: Stamp,
}

/// Port at which the cloud serves. It can be fixed, because each namespace has its own ports.
const SERVE_PORT: u16 = 5551;

impl TwoHostTestbed {
    /// Starts the aggregator and waits until it answers. The network is created in the deployment's folder.
    pub fn new(network: impl FnOnce(&Path) -> Network) -> Self {
        Self::with_scheme("tcp", network)
    }

    /// Starts the aggregator like [`new`](Self::new), for samples that are sent over the network of an address scheme.
    pub fn with_scheme(scheme: &'static str, network: impl FnOnce(&Path) -> Network) -> Self {
        let deployment = LoopbackDeployment::new();
        let network = network(deployment.folder());
        let (aggregator, api) = deployment.start_aggregator_at("0.0.0.0");
        Self { api, aggregator, deployment, scheme, network, start: stamp() }
    }

    /// Returns the folder for files of this test.
    pub fn folder(&self) -> &Path {
        self.deployment.folder()
    }

    /// Starts a cloud with an echo model; `tables` are added to its configuration.
    pub fn start_cloud(&self, tables: &str) -> Process {
        self.start_cloud_with(tables, &[])
    }

    /// Starts a cloud with additional environment variables.
    pub fn start_cloud_with(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        let serve = format!(
            "[serve]\nlisten = \"{}://0.0.0.0:{SERVE_PORT}\"\n[[model]]\nname = \"echo\"\nkind = \"echo\"\n",
            self.scheme
        );
        self.configure("cloud", self.network.cloud(), &format!("{serve}{tables}"));
        self.start_peernetd("cloud", self.network.cloud(), environment)
    }

    /// Starts an edge with these tables and environment variables.
    pub fn start_edge(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        self.configure("edge", self.network.edge(), tables);
        self.start_peernetd("edge", self.network.edge(), environment)
    }

    /// Starts an edge on the third host, with the name `third`.
    ///
    /// # Panics
    /// If there is no third host.
    pub fn start_third_edge(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        self.configure("third", self.network.third_host(), tables);
        self.start_peernetd("third", self.network.third_host(), environment)
    }

    /// Returns a pipeline with payloads of one size, which the cloud echoes; `keys` are additional keys.
    pub fn pipeline(&self, name: &str, bytes: u32, keys: &str) -> String {
        let peer = self.peer();
        format!(
            "[[pipeline]]\nname = \"{name}\"\nsensor = {{ kind = \"synthetic\", size_bytes = {bytes} }}\n\
             placement = {{ kind = \"remote\", peer = \"{peer}\", model = \"echo\" }}\n{keys}\n"
        )
    }

    /// Returns the address at which the cloud serves.
    pub fn peer(&self) -> String {
        format!("{}://{}:{SERVE_PORT}", self.scheme, self.network.cloud().address)
    }

    fn configure(&self, name: &str, host: &Host, tables: &str) -> PathBuf {
        let agent = agent_table(name, &host.test_address.to_string());
        self.deployment.write(&format!("{name}.toml"), &(agent + tables))
    }

    fn start_peernetd(&self, name: &str, host: &Host, environment: &[(&str, &str)]) -> Process {
        let file = format!("{name}.toml");
        host.start(&program("peernetd"), &["run", &file], self.deployment.folder(), environment)
    }

    /// Waits until there are at least `n` runs and all of them have finished.
    pub fn wait_for_runs(&self, n: usize) {
        self.api.wait_until("/api/v1/runs", |runs| {
            let runs = runs["runs"].as_array()?;
            (runs.len() >= n && runs.iter().all(|run| run["reason"] == "finished")).then_some(())
        });
    }

    /// Returns the clocks of a host, from the injected faults that the host reports.
    pub fn clock_of(&self, host: &str) -> HostClock {
        let path = format!("/api/v1/hosts/{host}");
        // `rehearsal` is the API's name for injected clock faults.
        self.api.wait_until(&path, |host| {
            HostClock::from_report(&host["clock"]["rehearsal"], |wall| self.raw_at(wall))
        })
    }

    /// Converts a time of the kernel's wall clock after the start of this test to the kernel's free-running clock. It is
    /// interpolated linearly, because a time daemon may change the rate of the wall clock by parts per million.
    pub fn raw_at(&self, wall: WallTime) -> RawTime {
        let (start, now) = (self.start, stamp());
        let share = (wall - start.wall).nanos() as f64 / (now.wall - start.wall).nanos() as f64;
        start.raw + Span::from_nanos(((now.raw - start.raw).nanos() as f64 * share).round() as i64)
    }

    /// Returns all answered iterations, as they are stored.
    pub fn iterations(&self) -> Vec<Iteration> {
        iterations(&self.folder().join("aggregator.sqlite"))
    }

    /// Runs an SQL query on the database.
    pub fn query_database(&self, sql: &str) -> String {
        query_database(&self.folder().join("aggregator.sqlite"), sql)
    }

    /// Stops the aggregator.
    ///
    /// # Panics
    /// If its exit code is not 0.
    pub fn stop(self) {
        self.stop_and_inspect(|| ());
    }

    /// Stops the aggregator and runs a closure before the files are removed.
    ///
    /// # Panics
    /// As [`stop`](Self::stop).
    pub fn stop_and_inspect<T>(self, inspect: impl FnOnce() -> T) -> T {
        let Self { aggregator, deployment: _deployment, network: _network, .. } = self;
        let end = aggregator.stop();
        assert_eq!(end.code(), 0, "{}", end.log);
        inspect()
    }
}
