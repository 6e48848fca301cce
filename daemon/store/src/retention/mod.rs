//! Retention: the writing task deletes old data between its commits, a little at a time, so that no commit waits for long,
//! and without examining all runs.
//!
//! Age is counted on the storage clock from the arrival of data, so no wall clock can make data old: neither the aggregator's
//! nor a robot's. The table `arrival` holds the time of arrival for each run or link and each kind of data. An index gives the
//! row that is due next, so a step with nothing to do costs a few index lookups, at most once a second. `trimmed` holds for
//! readers and for a rebuild how far each run was deleted. Deletions are recorded as an incident.

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

pub(crate) use self::arrivals::{pin, release};
use self::deletions::{Cause, Deletion, Deletions};
use self::size::SizeLimit;
use crate::raw_transaction;
use crate::retention_config::{RetentionConfig, period_s};
use crate::rollups::WIDTHS_S;
use crate::storage_clock::StorageClock;

/// Approximate cost of the data that a step deletes, in rows of the table `node`; it takes some tens of milliseconds.
pub(crate) const ROWS: u32 = 20_000;
/// Pause after a step with nothing to do.
const IDLE: Span = Span::from_seconds(1);
/// Number of parts of a period. Data that arrives within one part is deleted together, so that a kind has few rows in the
/// table `arrival`.
const PARTS: i64 = 64;
/// Length of a part for data that is kept without limit, seconds: the size limit, or a period that is configured later, needs it.
const UNLIMITED_RESOLUTION_S: i64 = 3_600;
/// Maximum number of runs and of links whose arrivals one transaction converts.
const ARRIVING: u32 = 64;

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nothing remains to be deleted now.
    Done,
    /// More remains to be deleted.
    More,
}

/// Kind of data with its own period.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    /// Iterations with everything that belongs to them.
    Nodes,
    /// Roll-ups of this width, seconds.
    Buckets(i64),
    /// Samples of the relation between two hosts' clocks.
    ClockSamples,
}

impl Kind {
    const OF_RUNS: [Self; WIDTHS_S.len() + 1] =
        [Self::Nodes, Self::Buckets(1), Self::Buckets(10), Self::Buckets(60), Self::Buckets(3600)];
    const ALL: [Self; WIDTHS_S.len() + 2] = [
        Self::Nodes,
        Self::Buckets(1),
        Self::Buckets(10),
        Self::Buckets(60),
        Self::Buckets(3600),
        Self::ClockSamples,
    ];

    /// Returns its number in the tables `arrival` and `trimmed`.
    const fn number(self) -> i64 {
        match self {
            Self::Nodes => 0,
            Self::Buckets(width_s) => width_s,
            Self::ClockSamples => -1,
        }
    }

    /// Returns the number of days for which it is kept; 0 for no limit.
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

    /// Returns the configuration key of its period.
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

    /// Returns a description of its items.
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

    /// Returns a description of their owner.
    const fn owner_description(self) -> &'static str {
        if matches!(self, Self::ClockSamples) { "link" } else { "run" }
    }
}

/// Period of each kind, seconds of the storage clock.
#[derive(Debug)]
struct Periods(RetentionConfig);

impl Periods {
    /// Returns the period of a kind; `None` for no limit.
    fn period_s(&self, kind: Kind) -> Option<i64> {
        period_s(kind.days(&self.0))
    }

    /// Returns the length of a part of the period: arrivals within one part are deleted together, seconds.
    fn resolution_s(&self, kind: Kind) -> i64 {
        self.period_s(kind).map_or(UNLIMITED_RESOLUTION_S, |period_s| (period_s / PARTS).max(1))
    }

    fn finest_resolution_s(&self) -> i64 {
        Kind::ALL.map(|kind| self.resolution_s(kind)).into_iter().min().unwrap_or(UNLIMITED_RESOLUTION_S)
    }
}

/// Amount of data that was deleted of a kind of a run or link.
#[derive(Clone, Copy, Debug, Default)]
struct DeletedRows {
    /// Cost of the deleted rows, in rows of the table `node`.
    cost: u64,
    /// Number of iterations, rows of statistics, or samples.
    items: u64,
    /// `true` if all requested data is deleted.
    complete: bool,
}

/// Deletion of old data.
#[derive(Debug)]
pub(crate) struct Retention {
    periods: Periods,
    /// Time of the last step with nothing to do.
    idle: Option<MonoTime>,
    size: SizeLimit,
    deletions: Deletions,
}

impl Retention {
    pub(crate) fn new(config: RetentionConfig) -> Self {
        Self {
            periods: Periods(config),
            idle: None,
            size: SizeLimit::new(config.size_limit_bytes),
            deletions: Deletions::new(config),
        }
    }

    /// Deletes data at a cost of at most about `max_cost`, in its own transaction; none may be open.
    ///
    /// # Errors
    /// When the database cannot be read or written now. The step can be tried again.
    pub(crate) async fn step(
        &mut self,
        connection: &mut SqliteConnection,
        storage_clock: &mut StorageClock,
        now: Stamp,
        max_cost: u32,
    ) -> Result<Step, sqlx::Error> {
        if self.idle.is_some_and(|idle| now.mono - idle < IDLE) {
            return Ok(Step::Done);
        }
        let now_s = whole_seconds(storage_clock.read(connection, now.mono).await?);
        let Some(work) = self.find_work(connection, now_s, now.mono).await? else {
            self.idle = Some(now.mono);
            self.deletions.log_at_rest(now_s);
            return Ok(Step::Done);
        };
        self.idle = None;
        let done = self.transaction(connection, storage_clock, work, now, max_cost.into()).await;
        match &done {
            Ok(()) => storage_clock.committed(now.mono),
            Err(_) => {
                self.deletions.forget();
                raw_transaction::roll_back(connection).await?;
            }
        }
        done.map(|()| Step::More)
    }

    /// Logs the deletions that were not logged yet, because no deletion follows soon.
    pub(crate) fn finish(&mut self) {
        self.deletions.finish();
    }

    async fn transaction(
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
        self.deletions.record(connection, &deletions, (now_s, now.wall)).await?;
        raw_transaction::commit(connection).await
    }

    /// Finds the next work.
    async fn find_work(
        &mut self,
        connection: &mut SqliteConnection,
        now_s: i64,
        now: MonoTime,
    ) -> Result<Option<Work>, sqlx::Error> {
        let since_s = now_s - self.periods.finest_resolution_s();
        if arriving::has_arrivals(connection, since_s).await? {
            return Ok(Some(Work::Arriving { since_s }));
        }
        for kind in Kind::ALL {
            if let Some(period_s) = self.periods.period_s(kind)
                && arrivals::has_due(connection, kind, now_s - period_s).await?
            {
                return Ok(Some(Work::Aged { kind, before_s: now_s - period_s }));
            }
        }
        Ok(self.size.is_exceeded(connection, now).await?.then_some(Work::TooLarge))
    }

    async fn perform(
        &mut self,
        connection: &mut SqliteConnection,
        work: Work,
        (now_s, now): (i64, Stamp),
        max_cost: u64,
        deletions: &mut Vec<Deletion>,
    ) -> Result<(), sqlx::Error> {
        match work {
            Work::Arriving { since_s } => {
                arriving::close(connection, &self.periods, since_s, now_s, ARRIVING).await?;
            }
            Work::Aged { kind, before_s } => {
                let what = (kind, Cause::Age);
                arrivals::trim(connection, what, before_s, now_s, max_cost, deletions).await?;
            }
            Work::TooLarge => {
                // Recent arrivals may be deleted as well, once no older iterations remain.
                if !arrivals::has_due(connection, Kind::Nodes, i64::MAX).await? {
                    arriving::close(connection, &self.periods, i64::MAX, now_s, ARRIVING).await?;
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
    /// Convert what has been arriving since this second of the storage clock to rows of the table `arrival`.
    Arriving { since_s: i64 },
    /// Delete data of this kind that had arrived by this second, a whole period ago.
    Aged { kind: Kind, before_s: i64 },
    /// Delete data because the file uses more than its limit.
    TooLarge,
}

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
