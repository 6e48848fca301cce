//! Types of the store that the live state also contains.

pub use peernet_analysis::clock_points::ClockPoint;
use serde::Serialize;

/// Counts of the stored data of one host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StoredCounts {
    /// Events of all kinds.
    pub events: u64,
    /// Nodes of iterations.
    pub nodes: u64,
    /// Gaps that the host reported or that were noticed in its streams.
    pub gaps: u64,
    /// Number of events in these gaps; events that could not be counted are not included.
    pub missing: u64,
    /// Batches that arrived more than once and were stored once, since the aggregator started.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}
