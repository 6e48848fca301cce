//! Metrics of the aggregator.

use peernet_aggregator::{LiveState, Totals};
use peernet_networks::zmtp::{Rejection, RejectionCounts};

use super::table::{Sample, Sink};

/// Figures of the aggregator.
#[derive(Debug)]
pub(super) struct AggregatorFigures {
    pub(super) ready: bool,
    /// Hosts that report.
    pub(super) connected: u64,
    /// Hosts of the picture.
    pub(super) known: u64,
    /// Hosts whose connections were refused recently.
    pub(super) refused: u64,
    /// Size of the database's files; `None` if there are none.
    pub(super) database_bytes: Option<u64>,
    /// Refused connections, by reason.
    pub(super) rejected: Vec<(&'static str, u64)>,
    pub(super) totals: Totals,
}

impl AggregatorFigures {
    /// Returns the figures of a picture, for an aggregator that is not ready and has no database.
    pub(super) fn of(picture: &LiveState) -> Self {
        Self {
            ready: false,
            connected: picture.hosts.iter().filter(|host| host.connected).count() as u64,
            known: picture.hosts.len() as u64,
            refused: picture.refused.len() as u64,
            database_bytes: None,
            rejected: Vec::new(),
            totals: picture.totals,
        }
    }

    /// Adds the counts of refused connections.
    pub(super) fn with_rejections(mut self, counts: &RejectionCounts) -> Self {
        self.rejected = Rejection::ALL.map(|reason| (reason.name(), counts.count(reason))).to_vec();
        self
    }

    /// Writes the size of the database.
    pub(super) fn database(&self, to: &mut Sink<'_>) {
        self.database_bytes.into_iter().for_each(|bytes| to(&[], Sample::Size(bytes)));
    }

    /// Writes the refused connections, by reason.
    pub(super) fn rejected(&self, to: &mut Sink<'_>) {
        self.rejected.iter().for_each(|(reason, count)| to(&[reason], Sample::Count(*count)));
    }
}
