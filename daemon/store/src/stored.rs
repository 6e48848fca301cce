//! Types of the store that the live state also contains.

pub use peernet_analysis::clock_points::ClockPoint;
use peernet_analysis::trust::MissingCount;
use serde::Serialize;
use sqlx::FromRow;

use crate::column::count;

/// Prefix of a gap's reason. It means that the events of the gap are in another database, to which the host sent its
/// stream before.
macro_rules! other_database_prefix {
    () => {
        "from before this database: "
    };
}

/// SQL expressions in a query of the table `host`: number of the host's missing events that are in another database,
/// number of the host's gaps of unknown size, and number of such gaps whose events are in another database.
macro_rules! gap_columns {
    // The only index of the table `gap` begins with the run, so gaps of a host are found by the host's runs.
    // Gaps of events that are in another database have no run.
    () => {
        concat!(
            "(SELECT coalesce(sum(count), 0) FROM gap WHERE gap.run IS NULL AND gap.host = host.id AND gap.reason LIKE '",
            $crate::stored::other_database_prefix!(),
            "%') AS in_other_database, \
             (SELECT count(*) FROM gap WHERE gap.run IS NULL AND gap.host = host.id AND gap.count = 0) + \
             (SELECT count(*) FROM pipeline CROSS JOIN run ON run.pipeline = pipeline.id \
              CROSS JOIN gap ON gap.run = run.number WHERE pipeline.host = host.id AND gap.count = 0) \
             AS unknown_gaps, \
             (SELECT count(*) FROM gap WHERE gap.run IS NULL AND gap.host = host.id AND gap.count = 0 AND gap.reason LIKE '",
            $crate::stored::other_database_prefix!(),
            "%') AS unknown_gaps_in_other_database"
        )
    };
}

pub(crate) use {gap_columns, other_database_prefix};

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
    /// Number of gaps whose number of events is unknown.
    pub unknown_gaps: u64,
    /// Number of the gaps in `unknown_gaps` whose events are in another database.
    pub unknown_gaps_in_other_database: u64,
    /// Number, since the aggregator started, of batches that arrived although they were already stored. They were not
    /// stored again.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}

/// Columns of a query of the table `host` with the counts of a host.
#[derive(FromRow)]
pub(crate) struct CountColumns {
    events: i64,
    nodes: i64,
    gaps: i64,
    missing: i64,
    quarantined: i64,
    in_other_database: i64,
    unknown_gaps: i64,
    unknown_gaps_in_other_database: i64,
}

impl From<CountColumns> for StoredCounts {
    fn from(columns: CountColumns) -> Self {
        Self {
            events: count(columns.events),
            nodes: count(columns.nodes),
            gaps: count(columns.gaps),
            missing: count(columns.missing),
            in_other_database: count(columns.in_other_database),
            unknown_gaps: count(columns.unknown_gaps),
            unknown_gaps_in_other_database: count(columns.unknown_gaps_in_other_database),
            // The store does not count duplicates; the live state does.
            duplicates: 0,
            quarantined: count(columns.quarantined),
        }
    }
}

impl StoredCounts {
    /// Returns the number of all missing events.
    pub const fn missing_count(&self) -> MissingCount {
        MissingCount { known: self.missing, is_incomplete: self.unknown_gaps > 0 }
    }

    /// Returns the number of missing events that are in no database.
    pub const fn missing_everywhere(&self) -> MissingCount {
        MissingCount {
            known: self.missing.saturating_sub(self.in_other_database),
            is_incomplete: self.unknown_gaps > self.unknown_gaps_in_other_database,
        }
    }
}
