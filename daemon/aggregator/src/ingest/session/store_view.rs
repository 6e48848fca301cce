//! The session's copy of the database's state.

use std::collections::HashSet;

use peernet_logger::{HostId, RunId};
use peernet_store::writing::Streams;

/// Maximum number of runs that wait for their names from the live lane.
// A hostile agent can send iterations of any number of runs without their start.
const MAX_UNNAMED_RUNS: usize = 1_024;

/// The streams and unnamed runs of the database.
#[derive(Debug)]
pub(super) struct StoreView {
    pub(super) streams: Streams,
    /// Runs that have iterations in the database but no start event, with their hosts.
    unnamed_runs: HashSet<(HostId, RunId)>,
    /// `true` while the writer has a database. While it has none, nothing is acknowledged.
    is_open: bool,
}

impl StoreView {
    /// Creates the state of an open database.
    pub(super) fn new(streams: Streams, unnamed_runs: Vec<(HostId, RunId)>) -> Self {
        Self { streams, unnamed_runs: unnamed_runs.into_iter().collect(), is_open: true }
    }

    /// Returns whether the writer has a database.
    pub(super) const fn is_open(&self) -> bool {
        self.is_open
    }

    /// Records that the database was closed.
    pub(super) const fn close(&mut self) {
        self.is_open = false;
    }

    /// Returns whether any run waits for its name.
    pub(super) fn has_unnamed(&self) -> bool {
        !self.unnamed_runs.is_empty()
    }

    /// Returns whether this run waits for its name.
    pub(super) fn is_unnamed(&self, host: HostId, run: RunId) -> bool {
        self.unnamed_runs.contains(&(host, run))
    }

    /// Records that the run was named.
    pub(super) fn record_name(&mut self, host: HostId, run: RunId) {
        self.unnamed_runs.remove(&(host, run));
    }

    /// Adds runs that have iterations in the database but no start event. Runs beyond `MAX_UNNAMED_RUNS` are ignored.
    pub(super) fn add_unnamed(&mut self, runs: impl IntoIterator<Item = (HostId, RunId)>) {
        let remaining_capacity = MAX_UNNAMED_RUNS.saturating_sub(self.unnamed_runs.len());
        self.unnamed_runs.extend(runs.into_iter().take(remaining_capacity));
    }
}
