//! What was found, as plain data. Columns named `_ns` are nanoseconds since 1970 UTC, as in the database.

use std::path::PathBuf;

use serde::Serialize;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Something is wrong, and somebody should do something.
    Problem,
    /// Worth knowing.
    Notice,
}

/// Something that was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How much it matters.
    pub severity: Severity,
    /// What is so.
    pub what: String,
    /// What to do.
    pub advice: String,
}

/// The state of a database.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// The file.
    pub database: PathBuf,
    /// Sizes.
    pub file: FileFigures,
    /// Which version's tables it has; `None` where that cannot be read.
    pub schema: Option<Schema>,
    /// What SQLite says of the file's inner order.
    pub integrity: Integrity,
    /// Numbers of pages that are malformed, the first of the file is 1. One that is not in use does no harm: whether any is,
    /// `integrity` says.
    pub malformed_pages: Vec<u32>,
    /// Rows per table.
    pub tables: Vec<TableRows>,
    /// The streams that were stored, the newest first, at most 1,000.
    pub streams: Vec<StreamState>,
    /// What never arrived, by host and reason, at most 1,000.
    pub gaps: Vec<GapGroup>,
    /// Batches that were put aside, by host and reason.
    pub quarantine: Vec<QuarantineGroup>,
    /// From when to when there are roll-ups, by width.
    pub rollups: Vec<RollupExtent>,
    /// Runs that go on as far as the database knows, of hosts that have been silent for an hour, at most 1,000.
    pub open_runs: Vec<OpenRun>,
    /// What of all this matters.
    pub findings: Vec<Finding>,
}

/// Sizes in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FileFigures {
    /// The file.
    pub bytes: u64,
    /// Within it, free for reuse.
    pub free_bytes: u64,
    /// The log beside it (`-wal`).
    pub wal_bytes: u64,
    /// Room on its disk.
    pub disk_free_bytes: u64,
}

/// Numbers of migrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Schema {
    /// The file's newest.
    pub found: i64,
    /// This program's newest.
    pub known: i64,
}

/// SQLite's own check.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Integrity {
    /// Whether indexes were compared with their tables, too.
    pub full: bool,
    /// What it found, at most 100.
    pub problems: Vec<String>,
    /// Whether rows can be found at all, so that a repair can salvage some.
    #[serde(skip)]
    pub(super) has_table_list: bool,
}

/// How many rows a table has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TableRows {
    /// The table.
    pub table: &'static str,
    /// Its rows.
    pub rows: u64,
    /// Whether they were computed from the ends of runs and a sample rather than counted.
    pub estimated: bool,
}

/// One stream of batches.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct StreamState {
    /// The host's name; `None` for one that never introduced itself.
    pub host: Option<String>,
    /// The stream's id.
    pub stream: String,
    /// All batches up to this number are stored.
    pub stored: i64,
    /// The stream that it follows.
    pub previous: Option<String>,
    /// When something of it was stored last, on the aggregator's clock.
    pub last_seen_ns: i64,
}

/// Events that never arrived.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct GapGroup {
    /// The host's name.
    pub host: Option<String>,
    /// Why.
    pub reason: String,
    /// Gaps.
    pub gaps: i64,
    /// Events in them, as far as they could be counted.
    pub events: i64,
    /// Gaps whose events could not be counted.
    pub uncounted: i64,
    /// When the first was dropped, on the host's clock.
    pub from_ns: i64,
    /// When the last was dropped.
    pub to_ns: i64,
}

/// Batches that were put aside.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct QuarantineGroup {
    /// The host's name.
    pub host: Option<String>,
    /// Why.
    pub reason: String,
    /// How many.
    pub batches: i64,
    /// When the last came, on the aggregator's clock.
    pub last_ns: i64,
}

/// Where there are roll-ups.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct RollupExtent {
    /// Width of the buckets.
    pub resolution_s: i64,
    /// Begin of the oldest, on the clocks of the edges; `None` where there are none.
    pub oldest_s: Option<i64>,
    /// Begin of the newest.
    pub newest_s: Option<i64>,
}

/// A run without an end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, sqlx::FromRow)]
pub struct OpenRun {
    /// Its number.
    pub number: i64,
    /// Its pipeline.
    pub pipeline: String,
    /// Its host's name.
    pub host: Option<String>,
    /// When its host was heard of last, on the aggregator's clock.
    pub last_seen_ns: i64,
}
