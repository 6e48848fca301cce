//! The session's copy of the database's state.

use std::collections::HashSet;

use peernet_logger::{HostId, RunId};
use peernet_store::writing::Streams;

/// Maximum number of runs that wait for their names. A name is a pipeline with its placement, as in a live update.
// A hostile agent can send iterations of any number of runs without their start.
const MAX_RUNS_WITHOUT_START: usize = 1_024;

/// The streams of the database, and its runs without a stored start.
#[derive(Debug)]
pub(super) struct StoreView {
    pub(super) streams: Streams,
    /// Runs that have iterations in the database but no start event, with their hosts. A run that was named is removed.
    runs_without_start: HashSet<(HostId, RunId)>,
    /// `true` while the writer has a database. While it has none, nothing is acknowledged.
    is_open: bool,
}

impl StoreView {
    /// Creates the state of an open database.
    pub(super) fn new(streams: Streams, runs_without_start: Vec<(HostId, RunId)>) -> Self {
        Self { streams, runs_without_start: runs_without_start.into_iter().collect(), is_open: true }
    }

    /// Returns whether the writer has a database.
    pub(super) const fn is_open(&self) -> bool {
        self.is_open
    }

    /// Records that the database was closed.
    pub(super) const fn close(&mut self) {
        self.is_open = false;
    }

    /// Returns whether any run without a start event waits for its description.
    pub(super) fn has_runs_without_start(&self) -> bool {
        !self.runs_without_start.is_empty()
    }

    /// Returns whether this run has no start event and waits for its description.
    pub(super) fn is_without_start(&self, host: HostId, run: RunId) -> bool {
        self.runs_without_start.contains(&(host, run))
    }

    /// Records that the run was described.
    pub(super) fn record_description(&mut self, host: HostId, run: RunId) {
        self.runs_without_start.remove(&(host, run));
    }

    /// Adds runs that have iterations in the database but no start event. Runs beyond `MAX_RUNS_WITHOUT_START` are
    /// ignored.
    pub(super) fn add_runs_without_start(&mut self, runs: impl IntoIterator<Item = (HostId, RunId)>) {
        let remaining_capacity = MAX_RUNS_WITHOUT_START.saturating_sub(self.runs_without_start.len());
        self.runs_without_start.extend(runs.into_iter().take(remaining_capacity));
    }
}
