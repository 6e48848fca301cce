//! An aggregator for tests, with its database in a temporary folder.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use peernet_aggregator::{Aggregator, AggregatorConfig, LiveState, RunningAggregator};
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, SqliteConnection};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use crate::agent::Agent;

/// A running aggregator that can be stopped and restarted.
pub(crate) struct Testbed {
    _folder: TempDir,
    pub(crate) database: PathBuf,
    pub(crate) clock: SharedClock,
    /// Address that the aggregator listens on; it stays the same after a restart.
    pub(crate) address: String,
    max_hosts: usize,
    running: Option<(RunningAggregator, CancellationToken)>,
}

impl Testbed {
    pub(crate) async fn new() -> Self {
        Self::with_max_hosts(AggregatorConfig::default().max_hosts).await
    }

    /// Starts an aggregator that stores at most `max_hosts` hosts.
    pub(crate) async fn with_max_hosts(max_hosts: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let database = folder.path().join("data/peernet.sqlite");
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")));
        let address = "tcp://127.0.0.1:0".to_owned();
        let mut testbed = Self { _folder: folder, database, clock, address, max_hosts, running: None };
        testbed.start().await;
        testbed
    }

    pub(crate) fn config(&self) -> AggregatorConfig {
        AggregatorConfig {
            name: "base".parse().ok(),
            listen: self.address.clone(),
            database: self.database.clone(),
            commit_interval_ms: 5,
            max_hosts: self.max_hosts,
            ..AggregatorConfig::default()
        }
    }

    pub(crate) async fn start(&mut self) {
        let stop = CancellationToken::new();
        let running =
            Aggregator::start(self.config(), Arc::clone(&self.clock), stop.clone()).await.expect("starts");
        self.address = running.handle.live().borrow().listening.clone();
        self.running = Some((running, stop));
    }

    /// Stops the aggregator as a signal would, and waits for its end.
    pub(crate) async fn stop(&mut self) {
        let (running, stop) = self.running.take().expect("runs");
        stop.cancel();
        running.join().await.expect("ends well");
    }

    pub(crate) fn aggregator(&self) -> &Aggregator {
        &self.running.as_ref().expect("runs").0.handle
    }

    pub(crate) async fn agent(&self, name: &str) -> Agent {
        Agent::new(name, &self.address, &self.clock).await
    }

    /// Waits for a snapshot of the live state for which `is_wanted` is true.
    pub(crate) async fn snapshot(
        &self,
        what: &str,
        is_wanted: impl Fn(&LiveState) -> bool,
    ) -> Arc<LiveState> {
        let mut live = self.aggregator().live();
        let wait = live.wait_for(|snapshot| is_wanted(snapshot));
        let snapshot = tokio::time::timeout(Duration::from_secs(30), wait).await;
        Arc::clone(&snapshot.unwrap_or_else(|_| panic!("waited in vain for {what}")).expect("runs"))
    }

    /// Opens a further connection to the database, as another program would.
    pub(crate) async fn connection(&self) -> SqliteConnection {
        SqliteConnectOptions::new().filename(&self.database).connect().await.expect("opens")
    }

    /// Returns the only value of a query.
    pub(crate) async fn count(&self, sql: &'static str) -> i64 {
        sqlx::query_scalar(sql).fetch_one(&mut self.connection().await).await.expect("counts")
    }
}
