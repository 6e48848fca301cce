//! Types of the store that the live state also contains.

pub use peernet_analysis::clock_points::ClockPoint;
use serde::Serialize;

/// Prefix of a gap's reason. It means that the events of the gap are in another database, to which the host sent its
/// stream before.
macro_rules! other_database_prefix {
    () => {
        "from before this database: "
    };
}

/// SQL expression in a query of the table `host`: number of the host's missing events that are in another database.
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
    /// Nodes of all iterations.
    pub nodes: u64,
    /// Gaps that the host reported, or that the aggregator noticed in the host's streams.
    pub gaps: u64,
    /// Number of events in `gaps`, without gaps whose number of events is unknown.
    pub missing: u64,
    /// Number of the missing events that are in another database, to which the host sent its stream before.
    #[serde(rename = "missing_before")]
    pub in_other_database: u64,
    /// Number, since the aggregator started, of batches that arrived although they were already stored. They were not
    /// stored again.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}

impl StoredCounts {
    /// Returns the number of missing events that are in no database, without gaps whose number of events is unknown.
    pub const fn missing_everywhere(&self) -> u64 {
        self.missing.saturating_sub(self.in_other_database)
    }
}
