//! Report of an examination, as plain data. Columns named `_ns` are nanoseconds since 1970 UTC, as in the database.

use std::path::PathBuf;

use serde::Serialize;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Something is wrong and needs action.
    Problem,
    /// Useful to know; no action needed.
    Notice,
}

/// One finding of an examination.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Severity of the finding.
    pub severity: Severity,
    /// Description of the finding.
    pub what: String,
    /// Advice on what to do.
    pub advice: String,
}

/// The state of a database.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// The file.
    pub database: PathBuf,
    /// Sizes.
    pub file: FileSizes,
    /// Version of the file's schema; `None` if the version cannot be read.
    pub schema: Option<Schema>,
    /// Result of SQLite's own check of the file.
    pub integrity: Integrity,
    /// Numbers of malformed pages; the first page of the file is 1. A malformed page that is not in use does no harm:
    /// `integrity` shows whether any of them is in use.
    pub malformed_pages: Vec<u32>,
    /// Rows per table.
    pub tables: Vec<TableRows>,
    /// The stored streams, newest first, at most 1,000.
    pub streams: Vec<StreamState>,
    /// Events that never arrived, by host and reason, at most 1,000.
    pub gaps: Vec<GapGroup>,
    /// Quarantined batches, by host and reason.
    pub quarantine: Vec<QuarantineGroup>,
    /// Time ranges of the roll-ups, by width.
    pub rollups: Vec<RollupExtent>,
    /// Runs that have not ended, of hosts that have been silent for an hour, at most 1,000.
    pub open_runs: Vec<OpenRun>,
    /// Problems and notices.
    pub findings: Vec<Finding>,
}

/// Sizes in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FileSizes {
    /// Size of the file.
    pub bytes: u64,
    /// Part of the file that is free for reuse.
    pub free_bytes: u64,
    /// Size of the write-ahead log beside the file (`-wal`).
    pub wal_bytes: u64,
    /// Free space on the disk of the file.
    pub disk_free_bytes: u64,
}

/// Versions of the schema, as numbers of migrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Schema {
    /// Newest migration in the file.
    pub found: i64,
    /// Newest migration that this program knows.
    pub known: i64,
}

/// Result of SQLite's own check.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Integrity {
    /// `true` if indexes were compared with their tables, too. They are not compared if the quick check found damage.
    pub full: bool,
    /// Errors that the check found, at most 100.
    pub problems: Vec<String>,
    /// `true` if the list of tables can be read. Without the list, a repair cannot find any row.
    #[serde(skip)]
    pub(super) has_table_list: bool,
}

/// Number of rows of a table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TableRows {
    /// Name of the table.
    pub table: &'static str,
    /// Number of its rows.
    pub rows: u64,
    /// `true` if the number was estimated from the first, the last and some newest iterations of each run.
    pub estimated: bool,
}

/// One stream of batches.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct StreamState {
    /// Name of the host; `None` if the host never introduced itself.
    pub host: Option<String>,
    /// The stream's id.
    pub stream: String,
    /// Number up to which all batches are stored.
    pub stored: i64,
    /// The stream that this stream continues.
    pub previous: Option<String>,
    /// Last time when the host introduced itself with this stream or a batch of it was stored, on the aggregator's clock.
    pub last_seen_ns: i64,
}

/// Events that never arrived.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct GapGroup {
    /// Name of the host.
    pub host: Option<String>,
    /// Reason for the gaps.
    pub reason: String,
    /// Number of gaps.
    pub gaps: i64,
    /// Number of events in these gaps. Events that could not be counted are not included.
    pub events: i64,
    /// Number of gaps whose events could not be counted.
    pub uncounted: i64,
    /// Start of the earliest gap, on the host's clock; on the aggregator's clock if the times of the events are unknown.
    pub from_ns: i64,
    /// End of the latest gap, on the host's clock; on the aggregator's clock if the times of the events are unknown.
    pub to_ns: i64,
}

/// Quarantined batches of one host that have the same reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct QuarantineGroup {
    /// Name of the host.
    pub host: Option<String>,
    /// Reason for the quarantine.
    pub reason: String,
    /// Number of batches.
    pub batches: i64,
    /// Time when the last batch arrived, on the aggregator's clock.
    pub last_ns: i64,
}

/// Time range of the roll-ups of one width.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct RollupExtent {
    /// Width of the buckets, seconds.
    pub resolution_s: i64,
    /// Start of the oldest bucket, on the clocks of the edges; `None` if there are no buckets.
    pub oldest_s: Option<i64>,
    /// Start of the newest bucket.
    pub newest_s: Option<i64>,
}

/// A run without an end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct OpenRun {
    /// Number of the run.
    pub number: i64,
    /// Name of the run's pipeline.
    pub pipeline: String,
    /// Name of the run's host.
    pub host: Option<String>,
    /// Time when the host was seen last, on the aggregator's clock.
    pub last_seen_ns: i64,
}
