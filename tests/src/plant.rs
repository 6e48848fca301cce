//! An edge and a cloud in a network of their own, reporting to an aggregator outside of it.

use std::path::{Path, PathBuf};

use peernet_clock::{Clock, ClockIdentity, RawTime, Span, Stamp, SystemClock, WallTime};

use crate::network::Host;
use crate::site::agent;
use crate::truth::{HostClock, Iteration, ask, iterations};
use crate::{Api, Network, Process, Site, program};

/// What the kernel's clocks show.
fn stamp() -> Stamp {
    SystemClock::new(ClockIdentity::new("boot", "system")).stamp()
}

/// Two hosts and an aggregator. The network goes last.
#[derive(Debug)]
pub struct Plant {
    /// The dashboard.
    pub api: Api,
    aggregator: Process,
    site: Site,
    /// Of the address at which the cloud serves.
    scheme: &'static str,
    /// Between the hosts.
    pub network: Network,
    /// The kernel's clocks before any host started.
    start: Stamp,
}

/// The port at which the cloud serves; a namespace has all ports for itself.
const SERVE: u16 = 5551;

impl Plant {
    /// Starts the aggregator and waits until it answers. The network is made in the site's folder.
    pub fn new(network: impl FnOnce(&Path) -> Network) -> Self {
        Self::over("tcp", network)
    }

    /// The same, with samples over the network that a scheme selects.
    pub fn over(scheme: &'static str, network: impl FnOnce(&Path) -> Network) -> Self {
        let site = Site::new();
        let network = network(site.folder());
        let (aggregator, api) = site.aggregator_for("0.0.0.0");
        Self { api, aggregator, site, scheme, network, start: stamp() }
    }

    /// A folder for this plant's files.
    pub fn folder(&self) -> &Path {
        self.site.folder()
    }

    /// Starts a cloud that echoes; `tables` are added to its configuration.
    pub fn cloud(&self, tables: &str) -> Process {
        self.cloud_with(tables, &[])
    }

    /// The same with environment variables.
    pub fn cloud_with(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        let own = format!(
            "[serve]\nlisten = \"{}://0.0.0.0:{SERVE}\"\n[[model]]\nname = \"echo\"\nkind = \"echo\"\n",
            self.scheme
        );
        self.configure("cloud", self.network.cloud(), &format!("{own}{tables}"));
        self.peernetd("cloud", self.network.cloud(), environment)
    }

    /// Starts an edge; each `[[pipeline]]` in `tables` that is given no placement asks the cloud to echo.
    pub fn edge(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        self.configure("edge", self.network.edge(), tables);
        self.peernetd("edge", self.network.edge(), environment)
    }

    /// Starts an edge on the third host, which has the name `third`.
    ///
    /// # Panics
    /// When there is none.
    pub fn third_edge(&self, tables: &str, environment: &[(&str, &str)]) -> Process {
        self.configure("third", self.network.third(), tables);
        self.peernetd("third", self.network.third(), environment)
    }

    /// A pipeline of payloads of one size that the cloud echoes; `more` are further keys.
    pub fn pipeline(&self, name: &str, bytes: u32, more: &str) -> String {
        let peer = self.peer();
        format!(
            "[[pipeline]]\nname = \"{name}\"\nsensor = {{ kind = \"synthetic\", size_bytes = {bytes} }}\n\
             placement = {{ kind = \"remote\", peer = \"{peer}\", model = \"echo\" }}\n{more}\n"
        )
    }

    /// Where the cloud serves.
    pub fn peer(&self) -> String {
        format!("{}://{}:{SERVE}", self.scheme, self.network.cloud().address)
    }

    fn configure(&self, name: &str, host: &Host, tables: &str) -> PathBuf {
        let agent = agent(name, &host.home.to_string());
        self.site.write(&format!("{name}.toml"), &(agent + tables))
    }

    fn peernetd(&self, name: &str, host: &Host, environment: &[(&str, &str)]) -> Process {
        let file = format!("{name}.toml");
        host.start(&program("peernetd"), &["run", &file], self.site.folder(), environment)
    }

    /// Waits until all runs so far, and at least `n`, have ended by themselves.
    pub fn finished(&self, n: usize) {
        self.api.until("/api/v1/runs", |runs| {
            let runs = runs["runs"].as_array()?;
            (runs.len() >= n && runs.iter().all(|run| run["reason"] == "finished")).then_some(())
        });
    }

    /// What is wrong with a host's clock on purpose, as the host itself tells.
    pub fn clock_of(&self, host: &str) -> HostClock {
        let path = format!("/api/v1/hosts/{host}");
        self.api.until(&path, |host| HostClock::told(&host["clock"]["rehearsal"], |wall| self.raw_at(wall)))
    }

    /// What the kernel's free-running clock showed when its wall clock showed something since the start of this plant. In between a
    /// time daemon may make the wall clock fast, by parts per million.
    pub fn raw_at(&self, wall: WallTime) -> RawTime {
        let (start, now) = (self.start, stamp());
        let share = (wall - start.wall).nanos() as f64 / (now.wall - start.wall).nanos() as f64;
        start.raw + Span::from_nanos(((now.raw - start.raw).nanos() as f64 * share).round() as i64)
    }

    /// All iterations that came back, as they are stored.
    pub fn iterations(&self) -> Vec<Iteration> {
        iterations(&self.folder().join("aggregator.sqlite"))
    }

    /// Asks the database, in a form that people could use, too.
    pub fn ask(&self, sql: &str) -> String {
        ask(&self.folder().join("aggregator.sqlite"), sql)
    }

    /// Stops the aggregator; it must have nothing to complain about.
    ///
    /// # Panics
    /// When it ends with another exit code than 0.
    pub fn stop(self) {
        self.stop_leaving(|| ());
    }

    /// The same, and looks at what it left.
    ///
    /// # Panics
    /// As [`stop`](Self::stop).
    pub fn stop_leaving<T>(self, look: impl FnOnce() -> T) -> T {
        let Self { aggregator, site: _site, network: _network, .. } = self;
        let ended = aggregator.stop();
        assert_eq!(ended.code(), 0, "{}", ended.log);
        look()
    }
}
