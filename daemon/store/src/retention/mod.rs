//! Retention: the writer's task deletes old data between its commits. The task deletes a little at a time, so that no
//! commit waits for long.
//!
//! The age of data is the time since its arrival, by the storage clock. Therefore neither a wrong
//! wall clock of the aggregator nor a wrong wall clock of a robot makes data old. For each kind of
//! data of each run or link, the table `arrival` holds the times of arrival. The writer first
//! records recent arrivals in the row of their run or link, and retention later converts such a
//! record to rows of `arrival`. An index gives the row of `arrival` that is due next, so retention
//! does not examine all runs: a step with nothing to do costs a few index lookups, at most once a
//! second. The table `trimmed` tells readers and a rebuild up to which time data of a run is
//! deleted. Deletions are recorded as an incident.

mod arrivals;
mod arriving;
mod buckets;
mod clocks;
mod deletions;
mod nodes;
mod size;
mod trimmed;

use peernet_clock::{MonoTime, Span, Stamp};
use sqlx::SqliteConnection;

pub(crate) use self::arrivals::{begin_retention_period, pin};
use self::deletions::{Cause, Deletion, Deletions};
use self::size::SizeLimit;
use crate::raw_transaction;
use crate::retention_config::{RetentionConfig, period_s};
use crate::rollups::WIDTHS_S;
use crate::storage_clock::StorageClock;

/// Approximate maximum cost of the data that one step deletes, in rows of the table `node`. Such a step takes some tens
/// of milliseconds.
pub(crate) const MAX_STEP_COST: u32 = 20_000;
/// Pause after a step with nothing to do. A due row is therefore deleted at most this time late.
const IDLE_PAUSE: Span = Span::from_seconds(1);
/// Number of parts of a retention period. Data that arrives within one part is deleted together, so that a kind of data
/// has few rows in the table `arrival`.
const PARTS_PER_PERIOD: i64 = 64;
/// Length of a part for data that is kept without limit, seconds. The arrivals of such data are recorded, too: the size
/// limit may delete the data, and a period may be configured later.
const UNLIMITED_RESOLUTION_S: i64 = 3_600;
/// Maximum number of runs, and of links, whose recent arrivals one transaction converts to rows of the table `arrival`.
const MAX_CONVERTED: u32 = 64;

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepResult {
    /// Nothing remains to be deleted now.
    Done,
    /// More remains to be deleted.
    More,
}

/// Kind of data that has its own retention period.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    /// Iterations with their nodes, transits and anchors.
    Nodes,
    /// Roll-ups of this width, seconds.
    Buckets(i64),
    /// Samples of the relation between two hosts' clocks.
    ClockSamples,
}

impl Kind {
    /// The kinds of data that belong to runs.
    const OF_RUNS: [Self; WIDTHS_S.len() + 1] =
        [Self::Nodes, Self::Buckets(1), Self::Buckets(10), Self::Buckets(60), Self::Buckets(3600)];
    /// All kinds, in the order in which due data is deleted.
    const ALL: [Self; WIDTHS_S.len() + 2] = [
        Self::Nodes,
        Self::Buckets(1),
        Self::Buckets(10),
        Self::Buckets(60),
        Self::Buckets(3600),
        Self::ClockSamples,
    ];

    /// Returns the number of the kind in the tables `arrival` and `trimmed`.
    const fn number(self) -> i64 {
        match self {
            Self::Nodes => 0,
            Self::Buckets(width_s) => width_s,
            Self::ClockSamples => -1,
        }
    }

    /// Returns the retention period of the kind in days; 0 for no limit.
    const fn days(self, config: &RetentionConfig) -> u32 {
        match self {
            Self::Nodes => config.nodes_days,
            Self::Buckets(1) => config.seconds_days,
            Self::Buckets(10) => config.ten_seconds_days,
            Self::Buckets(60) => config.minutes_days,
            Self::Buckets(_) => config.hours_days,
            Self::ClockSamples => config.clock_samples_days,
        }
    }

    /// Returns the configuration key of the kind's period.
    const fn key(self) -> &'static str {
        match self {
            Self::Nodes => "nodes_days",
            Self::Buckets(1) => "seconds_days",
            Self::Buckets(10) => "ten_seconds_days",
            Self::Buckets(60) => "minutes_days",
            Self::Buckets(_) => "hours_days",
            Self::ClockSamples => "clock_samples_days",
        }
    }

    /// Returns the words for the data of the kind in incidents.
    const fn description(self) -> &'static str {
        match self {
            Self::Nodes => "iterations with their trees",
            Self::Buckets(1) => "statistics per second",
            Self::Buckets(10) => "statistics per ten seconds",
            Self::Buckets(60) => "statistics per minute",
            Self::Buckets(_) => "statistics per hour",
            Self::ClockSamples => "clock samples",
        }
    }

    /// Returns the word for the owner of the data in incidents.
    const fn owner_description(self) -> &'static str {
        if matches!(self, Self::ClockSamples) { "link" } else { "run" }
    }
}

/// Retention period of each kind.
#[derive(Debug)]
struct Periods(RetentionConfig);

impl Periods {
    /// Returns the period of a kind in seconds of the storage clock; `None` for no limit.
    fn period_s(&self, kind: Kind) -> Option<i64> {
        period_s(kind.days(&self.0))
    }

    /// Returns the length of one of the [`PARTS_PER_PERIOD`] parts of the kind's period, seconds.
    fn resolution_s(&self, kind: Kind) -> i64 {
        self.period_s(kind).map_or(UNLIMITED_RESOLUTION_S, |period_s| (period_s / PARTS_PER_PERIOD).max(1))
    }

    fn finest_resolution_s(&self) -> i64 {
        Kind::ALL.map(|kind| self.resolution_s(kind)).into_iter().min().unwrap_or(UNLIMITED_RESOLUTION_S)
    }
}

/// Amount of data of one kind that was deleted from a run or link.
#[derive(Clone, Copy, Debug, Default)]
struct DeletedRows {
    /// Cost of the deleted rows, in rows of the table `node`.
    cost: u64,
    /// Number of iterations, rows of statistics, or clock samples.
    items: u64,
    /// `true` if all data that was to be deleted is deleted.
    is_complete: bool,
}

/// Deletion of old data.
#[derive(Debug)]
pub(crate) struct Retention {
    periods: Periods,
    /// Time of the last step, if this step had nothing to do.
    idle_since: Option<MonoTime>,
    size: SizeLimit,
    deletions: Deletions,
}

impl Retention {
    pub(crate) fn new(config: RetentionConfig) -> Self {
        Self {
            periods: Periods(config),
            idle_since: None,
            size: SizeLimit::new(config.size_limit_bytes),
            deletions: Deletions::new(config),
        }
    }

    /// Deletes data in a separate transaction, at a cost of at most about `max_cost` rows of the table `node`. No
    /// transaction may be open.
    ///
    /// # Errors
    /// When the database cannot be read or written now. The step can be tried again.
    pub(crate) async fn step(
        &mut self,
        connection: &mut SqliteConnection,
        storage_clock: &mut StorageClock,
        now: Stamp,
        max_cost: u32,
    ) -> Result<StepResult, sqlx::Error> {
        // For `IDLE_PAUSE` after a step with nothing to do, further calls cost nothing.
        if self.idle_since.is_some_and(|idle_since| now.mono - idle_since < IDLE_PAUSE) {
            return Ok(StepResult::Done);
        }
        let now_s = whole_seconds(storage_clock.read(connection, now.mono).await?);
        let Some(work) = self.find_work(connection, now_s, now.mono).await? else {
            self.idle_since = Some(now.mono);
            self.deletions.log_when_idle(now_s);
            return Ok(StepResult::Done);
        };
        self.idle_since = None;
        let result = self.perform_in_transaction(connection, storage_clock, work, now, max_cost.into()).await;
        match &result {
            Ok(()) => storage_clock.record_commit(now.mono),
            Err(_) => {
                // The record of the deletions is rolled back together with the deletions.
                self.deletions.forget();
                raw_transaction::roll_back(connection).await?;
            }
        }
        result.map(|()| StepResult::More)
    }

    /// Logs the deletions that were not logged yet. To be called before the aggregator stops storing.
    pub(crate) fn finish(&mut self) {
        self.deletions.finish();
    }

    /// Performs work in one transaction.
    async fn perform_in_transaction(
        &mut self,
        connection: &mut SqliteConnection,
        storage_clock: &StorageClock,
        work: Work,
        now: Stamp,
        max_cost: u64,
    ) -> Result<(), sqlx::Error> {
        raw_transaction::begin(connection).await?;
        let now_s = whole_seconds(storage_clock.advance(connection, now).await?);
        let mut deletions = Vec::new();
        self.perform(connection, work, (now_s, now), max_cost, &mut deletions).await?;
        // The incident is part of the same transaction, so that no data is deleted without a record.
        self.deletions.record(connection, &deletions, (now_s, now.wall)).await?;
        raw_transaction::commit(connection).await
    }

    /// Returns the next work; `None` if there is nothing to do now.
    async fn find_work(
        &mut self,
        connection: &mut SqliteConnection,
        now_s: i64,
        now: MonoTime,
    ) -> Result<Option<Work>, sqlx::Error> {
        let until_s = now_s - self.periods.finest_resolution_s();
        // Recent arrivals are converted first, because only rows of the table `arrival` become due.
        if arriving::has_records(connection, until_s).await? {
            return Ok(Some(Work::ConvertArrivals { until_s }));
        }
        for kind in Kind::ALL {
            if let Some(period_s) = self.periods.period_s(kind)
                && arrivals::has_due(connection, kind, now_s - period_s).await?
            {
                return Ok(Some(Work::DeleteAged { kind, until_s: now_s - period_s }));
            }
        }
        // The size is checked last, because the deletion of due data may free enough pages.
        Ok(self.size.is_exceeded(connection, now).await?.then_some(Work::ReduceSize))
    }

    /// Performs work within the open transaction.
    async fn perform(
        &mut self,
        connection: &mut SqliteConnection,
        work: Work,
        (now_s, now): (i64, Stamp),
        max_cost: u64,
        deletions: &mut Vec<Deletion>,
    ) -> Result<(), sqlx::Error> {
        match work {
            Work::ConvertArrivals { until_s } => {
                arriving::convert(connection, &self.periods, until_s, now_s, MAX_CONVERTED).await?;
            }
            Work::DeleteAged { kind, until_s } => {
                arrivals::trim(connection, (kind, Cause::Age), until_s, now_s, max_cost, deletions).await?;
            }
            Work::ReduceSize => {
                // If the table `arrival` has no iterations, records of recent arrivals are converted
                // without waiting, so that this data can be deleted, too.
                if !arrivals::has_due(connection, Kind::Nodes, i64::MAX).await? {
                    arriving::convert(connection, &self.periods, i64::MAX, now_s, MAX_CONVERTED).await?;
                }
                if !self.size.reduce(connection, (now_s, now.wall), max_cost, deletions).await? {
                    self.size.give_up(now.mono);
                }
            }
        }
        Ok(())
    }
}

/// Work of one transaction.
#[derive(Debug)]
enum Work {
    /// Convert the records of recent arrivals that began at this second of the storage clock or
    /// before to rows of the table `arrival`.
    ConvertArrivals { until_s: i64 },
    /// Delete the data of this kind that arrived at this second of the storage clock or before. The
    /// second lies a whole period in the past.
    DeleteAged { kind: Kind, until_s: i64 },
    /// Delete data because the database uses more bytes than the size limit.
    ReduceSize,
}

/// Rounds a reading of the storage clock down to whole seconds.
const fn whole_seconds(elapsed: Span) -> i64 {
    elapsed.nanos().div_euclid(1_000_000_000)
}

/// Statements of a step, whose query plans a test checks.
#[cfg(test)]
pub(crate) fn statements() -> Vec<(&'static str, &'static str)> {
    [
        &arrivals::STATEMENTS[..],
        &arriving::STATEMENTS,
        &nodes::STATEMENTS,
        &buckets::STATEMENTS,
        &clocks::STATEMENTS,
        &deletions::STATEMENTS,
        &trimmed::STATEMENTS,
        &crate::incidents::STATEMENTS,
        &crate::storage_clock::STATEMENTS,
    ]
    .concat()
}
