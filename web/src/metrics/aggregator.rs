//! Metrics of the aggregator.

use peernet_aggregator::{LiveState, Totals};
use peernet_networks::zmtp::{Rejection, RejectionCounts};

use super::table::{Sample, Sink};

/// Values of the metrics of the aggregator.
#[derive(Debug)]
pub(super) struct AggregatorNumbers {
    /// `true` while batches are stored and acknowledged.
    pub(super) ready: bool,
    /// Number of hosts that report.
    pub(super) connected: u64,
    /// Number of hosts in the live state.
    pub(super) known: u64,
    /// Number of hosts whose connections were refused in the last ten minutes.
    pub(super) refused: u64,
    /// Size of the database's files, bytes; `None` if there are no files.
    pub(super) database_bytes: Option<u64>,
    /// Number of refused connections for each reason.
    pub(super) rejections: Vec<(&'static str, u64)>,
    /// Counts over all hosts.
    pub(super) totals: Totals,
}

impl AggregatorNumbers {
    /// Returns the numbers of the live state. All other fields have the values of an aggregator that is not ready and has no database.
    pub(super) fn from_live_state(live_state: &LiveState) -> Self {
        Self {
            ready: false,
            connected: live_state.hosts.iter().filter(|host| host.connected).count() as u64,
            known: live_state.hosts.len() as u64,
            refused: live_state.refused.len() as u64,
            database_bytes: None,
            rejections: Vec::new(),
            totals: live_state.totals,
        }
    }

    /// Adds the counts of refused connections.
    pub(super) fn with_rejections(mut self, counts: &RejectionCounts) -> Self {
        self.rejections = Rejection::ALL.map(|reason| (reason.name(), counts.count(reason))).to_vec();
        self
    }

    /// Writes the size of the database, if there are files.
    pub(super) fn write_database(&self, sink: &mut Sink<'_>) {
        self.database_bytes.into_iter().for_each(|bytes| sink(&[], Sample::Size(bytes)));
    }

    /// Writes the refused connections, by reason.
    pub(super) fn write_rejections(&self, sink: &mut Sink<'_>) {
        self.rejections.iter().for_each(|(reason, count)| sink(&[reason], Sample::Count(*count)));
    }
}
