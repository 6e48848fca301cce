//! Deleting what is old, by the task that writes and between its commits: a little at a time, so that nothing waits
//! for it, and without looking through all runs.
//!
//! The table `retained` has a row for each run and each kind of data that is not kept for ever, with the second from
//! which its period counts: at first when the run arrived, later when the oldest of what is left began. An index gives
//! the next one that is due, so a step with nothing to do asks a few questions of an index and no more, at most once a
//! second. Where each run was trimmed stands in `trimmed`, for readers and for a rebuild.

mod buckets;
mod clocks;
mod nodes;
mod runs;
mod size;
mod trimmed;

use peernet_clock::{Span, WallTime};
use sqlx::{Connection, SqliteConnection};

use self::clocks::ClockSamples;
use self::runs::Reach;
pub(crate) use self::runs::{pin, release};
use self::size::SizeLimit;
use super::write::rollups::WIDTHS_S;
use crate::config::retention::{RetentionConfig, kept_s};

/// Rows that a step deletes, as a hint for its caller: some tens of milliseconds.
pub(crate) const ROWS: u32 = 20_000;
/// When there was nothing to do, it is not looked again for so long.
const IDLE: Span = Span::from_seconds(1);
/// What is due waits for this part of its period, at most [`MOST_SLACK_S`], so that much goes at once and not a row
/// each second.
const SLACK: i64 = 24;
const MOST_SLACK_S: i64 = 3_600;
/// Runs that one transaction looks at.
const RUNS: usize = 64;

/// What a step leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// There is nothing to do for now.
    Done,
    /// Another step would find something to do.
    More,
}

/// What is deleted separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Iterations with all that belongs to them.
    Nodes,
    /// Roll-ups of this width, seconds.
    Buckets(i64),
}

impl Kind {
    const ALL: [Self; WIDTHS_S.len() + 1] =
        [Self::Nodes, Self::Buckets(1), Self::Buckets(10), Self::Buckets(60), Self::Buckets(3600)];

    /// As in the tables `retained` and `trimmed`.
    const fn number(self) -> i64 {
        match self {
            Self::Nodes => 0,
            Self::Buckets(width_s) => width_s,
        }
    }

    /// What begins before this second is older than another one: an iteration counts from its begin, a bucket from its end.
    const fn end_s(self, before_s: i64) -> i64 {
        match self {
            Self::Nodes => before_s,
            Self::Buckets(width_s) => before_s - width_s + 1,
        }
    }
}

/// What was deleted of a kind of a run, in the cost of a small row.
#[derive(Clone, Copy, Debug)]
struct Deleted {
    rows: u64,
    /// When the oldest of what is left began.
    left_s: Option<i64>,
}

/// Deletes what is old.
#[derive(Debug)]
pub(crate) struct Retention {
    config: RetentionConfig,
    /// When there was last nothing to do.
    idle: Option<WallTime>,
    clocks: ClockSamples,
    size: SizeLimit,
}

impl Retention {
    pub(crate) fn new(config: RetentionConfig) -> Self {
        Self {
            config,
            idle: None,
            clocks: ClockSamples::new(kept_s(config.clock_samples_days)),
            size: SizeLimit::new(config.size_limit_bytes),
        }
    }

    /// Deletes about `rows` rows at most, in a transaction of its own; none must be open.
    ///
    /// # Errors
    /// When the database cannot be read or written now; the step can be tried again.
    pub(crate) async fn step(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
        rows: u32,
    ) -> Result<Step, sqlx::Error> {
        // A clock that was set back must not make this wait for hours.
        if self.idle.is_some_and(|idle| now >= idle && now < idle + IDLE) {
            return Ok(Step::Done);
        }
        let Some(work) = self.look(connection, now).await? else {
            self.idle = Some(now);
            return Ok(Step::Done);
        };
        self.idle = None;
        // Rolled back when it is dropped.
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
        self.perform(&mut transaction, work, now, rows.into()).await?;
        transaction.commit().await?;
        Ok(Step::More)
    }

    /// The next thing to do.
    async fn look(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
    ) -> Result<Option<Work>, sqlx::Error> {
        if runs::arrived(connection).await? {
            return Ok(Some(Work::Arrivals));
        }
        for kind in Kind::ALL {
            if let Some(kept_s) = self.kept_s(kind)
                && runs::due(connection, kind, due_s(now, kept_s)).await?
            {
                return Ok(Some(Work::Aged(kind, kept_s)));
            }
        }
        if self.size.exceeded(connection, now).await? {
            return Ok(Some(Work::TooLarge));
        }
        Ok(self.clocks.next(connection, now).await?.map(Work::Clock))
    }

    async fn perform(
        &mut self,
        connection: &mut SqliteConnection,
        work: Work,
        now: WallTime,
        rows: u64,
    ) -> Result<(), sqlx::Error> {
        match work {
            Work::Arrivals => runs::arrive(connection, now.unix_seconds(), rows).await,
            Work::Aged(kind, kept_s) => {
                let end_s = kind.end_s(now.unix_seconds() - kept_s);
                let reach = Reach::Aged { due_s: due_s(now, kept_s), end_s };
                runs::trim(connection, kind, reach, now, rows).await?;
                Ok(())
            }
            Work::TooLarge => self.size.reduce(connection, now, rows).await,
            Work::Clock(due) => ClockSamples::perform(connection, due, rows).await,
        }
    }

    fn kept_s(&self, kind: Kind) -> Option<i64> {
        kept_s(match kind {
            Kind::Nodes => self.config.nodes_days,
            Kind::Buckets(1) => self.config.seconds_days,
            Kind::Buckets(10) => self.config.ten_seconds_days,
            Kind::Buckets(60) => self.config.minutes_days,
            Kind::Buckets(_) => self.config.hours_days,
        })
    }
}

/// What a transaction does.
#[derive(Debug)]
enum Work {
    /// Runs that retention has not seen yet.
    Arrivals,
    /// Some of this kind is older than so many seconds.
    Aged(Kind, i64),
    /// The file uses more than it may.
    TooLarge,
    /// Samples of a clock relation may be too old.
    Clock(clocks::Due),
}

/// What has to begin before this second for its run to be looked at.
fn due_s(now: WallTime, kept_s: i64) -> i64 {
    now.unix_seconds() - kept_s - slack_s(kept_s)
}

/// By how much what is so old may be taken for younger or older than it is, to delete much at once.
fn slack_s(age_s: i64) -> i64 {
    (age_s / SLACK).clamp(1, MOST_SLACK_S)
}

/// What a step asks: a test looks at the plans.
#[cfg(test)]
pub(crate) fn statements() -> Vec<(&'static str, &'static str)> {
    [
        &runs::STATEMENTS[..],
        &nodes::STATEMENTS,
        &buckets::STATEMENTS,
        &clocks::STATEMENTS,
        &trimmed::STATEMENTS,
    ]
    .concat()
}
