//! Types of the store that the live state also contains.

pub use peernet_analysis::clock_points::ClockPoint;
use serde::Serialize;

/// Prefix of the reason of a gap whose events are in another database, because their host streamed to it before.
macro_rules! other_database_prefix {
    () => {
        "from before this database: "
    };
}

/// SQL expression for a row of `host`: number of the host's missing events that are in another database.
macro_rules! in_other_database {
    () => {
        concat!(
            "(SELECT coalesce(sum(count), 0) FROM gap WHERE gap.run IS NULL AND gap.host = host.id AND gap.reason LIKE '",
            $crate::stored::other_database_prefix!(),
            "%') AS in_other_database"
        )
    };
}

pub(crate) use {in_other_database, other_database_prefix};

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
    /// Number of the missing events that are in another database, because the host streamed to it before.
    #[serde(rename = "missing_before")]
    pub in_other_database: u64,
    /// Batches that arrived more than once and were stored once, since the aggregator started.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}

impl StoredCounts {
    /// Returns the number of missing events that are in no database, as far as they could be counted.
    pub const fn missing_here(&self) -> u64 {
        self.missing.saturating_sub(self.in_other_database)
    }
}
