//! What the session knows of the database.

use std::collections::HashSet;

use peernet_logger::{HostId, RunId};
use peernet_store::writing::Streams;

/// Runs that wait for the live lane to name them.
const MOST_UNNAMED: usize = 1_024;

/// The streams and unnamed runs that the database holds, and whether there is one.
#[derive(Debug)]
pub(super) struct StoreView {
    pub(super) streams: Streams,
    /// Runs of which the database knows iterations only, by their hosts.
    unnamed: HashSet<(HostId, RunId)>,
    /// Whether the writer has a database: while it has none, nothing is acknowledged.
    is_open: bool,
}

impl StoreView {
    /// An open database that holds these streams, and of these runs iterations only.
    pub(super) fn new(streams: Streams, unnamed: Vec<(HostId, RunId)>) -> Self {
        Self { streams, unnamed: unnamed.into_iter().collect(), is_open: true }
    }

    /// Whether the writer has a database.
    pub(super) const fn is_open(&self) -> bool {
        self.is_open
    }

    /// The database was closed.
    pub(super) const fn close(&mut self) {
        self.is_open = false;
    }

    /// Whether any run waits to be named.
    pub(super) fn has_unnamed(&self) -> bool {
        !self.unnamed.is_empty()
    }

    /// Whether this run waits to be named.
    pub(super) fn is_unnamed(&self, host: HostId, run: RunId) -> bool {
        self.unnamed.contains(&(host, run))
    }

    /// The run was named.
    pub(super) fn named(&mut self, host: HostId, run: RunId) {
        self.unnamed.remove(&(host, run));
    }

    /// More runs of which the database knows iterations only; those beyond the limit are left out.
    pub(super) fn add_unnamed(&mut self, runs: impl IntoIterator<Item = (HostId, RunId)>) {
        let room = MOST_UNNAMED.saturating_sub(self.unnamed.len());
        self.unnamed.extend(runs.into_iter().take(room));
    }
}
