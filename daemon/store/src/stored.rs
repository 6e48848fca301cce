//! Types of the store that the live state also contains.

pub use peernet_analysis::clock_points::ClockPoint;
use serde::Serialize;

/// Beginning of the reason of a gap of events that another database stored before their host connected to this one.
macro_rules! before_database {
    () => {
        "from before this database: "
    };
}

/// SQL expression: number of a host's events that another database stored before the host connected to this
/// one, for a row of `host`.
macro_rules! missing_before {
    () => {
        concat!(
            "(SELECT coalesce(sum(count), 0) FROM gap WHERE gap.run IS NULL AND gap.host = host.id AND gap.reason LIKE '",
            $crate::stored::before_database!(),
            "%') AS missing_before"
        )
    };
}

pub(crate) use {before_database, missing_before};

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
    /// Number of the missing events that were stored in another database before the host connected to this one.
    pub missing_before: u64,
    /// Batches that arrived more than once and were stored once, since the aggregator started.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}
