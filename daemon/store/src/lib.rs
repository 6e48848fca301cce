//! The store: the aggregator's SQLite database, and the only place that knows SQL.
//!
//! [`Store`] answers what people and programs ask, over connections of its own. `write` is the writer's, `retention` what
//! the writer deletes between commits, `maintenance` what an operator does with the file.

mod column;
pub(crate) mod contents;
pub(crate) mod database;
mod database_error;
mod error;
mod extent;
mod figures;
pub(crate) mod foreign_log;
mod incidents;
mod insert;
mod integrity;
mod limits;
mod lock;
pub mod maintenance;
mod opening;
pub mod plausible;
mod raw_transaction;
mod read;
mod readers;
pub(crate) mod rebuild;
mod retention;
mod retention_config;
mod rollups;
mod storage_clock;
mod stored;
#[cfg(test)]
mod tests;
mod types;
mod wall_clock;
mod write;

use peernet_analysis::trust::TrustInput;
use peernet_clock::WallTime;
use peernet_logger::Name;
use peernet_stream::Iteration;

use readers::Readers;

pub use database_error::DatabaseError;
pub use error::{OpenError, StoreError};
pub use figures::{Bound, Figures, P95_NEEDS, P99_NEEDS, rank};
pub use lock::{DatabaseLock, LockError};
pub use retention_config::RetentionConfig;
pub use stored::{ClockPoint, Stored};
pub use types::{
    AggregatorIncidentKind, ClockSeries, DelayAssumptions, DelayRow, Episodes, ExperimentSummary, GapRow,
    Histogram, HostRow, IncidentFilter, IncidentRow, IterationDetail, IterationFilter, IterationRow,
    Judgement, Kept, LinkKey, LinkRow, MeanBucket, Pairs, Recomputed, RecomputedStage, RunDetail, RunFilter,
    RunStatistics, RunSummary, Series, SeriesPoint, StageCourse, StageMeans, StageSeries, StageStatistics,
};

/// Types for the one process that writes to the database.
pub mod writing {
    pub use crate::integrity::Integrity;
    pub use crate::opening::{OpenDatabase, ReopenError, StoredState};
    pub use crate::readers::Readers;
    pub use crate::retention::Step;
    pub use crate::write::{
        Aside, CommitError, Committed, ConnectionSample, FormerFiles, Introduction, PendingIncidents,
        RunName, Streams, Work, Writer,
    };
}

/// Read-only access to what is stored, over connections of its own: never blocks the writer.
#[derive(Clone, Debug)]
pub struct Store {
    readers: Readers,
}

impl Store {
    /// Answers over these connections.
    pub fn new(readers: Readers) -> Self {
        Self { readers }
    }

    /// Closes the connections; questions that are under way are answered first. Later ones are refused.
    pub async fn close(&self) {
        self.readers.close().await;
    }

    /// Answers questions again, over new connections.
    pub fn reopen(&self) {
        self.readers.reopen();
    }

    /// Runs, newest first.
    ///
    /// # Errors
    /// When the database cannot be read; so for all questions here.
    pub async fn runs(&self, filter: &RunFilter) -> Result<Vec<RunSummary>, StoreError> {
        read::runs::runs(&self.readers, filter).await
    }

    /// One run; `None` when there is no run of that number. So for all questions about a run.
    pub async fn run(&self, number: i64) -> Result<Option<RunDetail>, StoreError> {
        read::runs::run(&self.readers, number).await
    }

    /// The first runs of an experiment, oldest first; `limit` is 1 to 1,000. None where there is no such experiment.
    pub async fn runs_of_experiment(&self, id: &str, limit: u32) -> Result<Vec<RunSummary>, StoreError> {
        read::runs::runs_of_experiment(&self.readers, id, limit).await
    }

    /// Experiments, the one with the newest run first; `limit` is 1 to 1,000.
    pub async fn experiments(&self, limit: u32) -> Result<Vec<ExperimentSummary>, StoreError> {
        read::runs::experiments(&self.readers, limit).await
    }

    /// Node names over the time of a run, each in at most `most_buckets` summaries; in the order asked for, those
    /// without samples left out.
    pub async fn course(
        &self,
        run: i64,
        stages: &[Name],
        most_buckets: usize,
    ) -> Result<Vec<StageCourse>, StoreError> {
        read::statistics::course(&self.readers, run, stages, most_buckets).await
    }

    /// As [`Store::course`], of which only counts and means are wanted: a tenth of the work.
    pub async fn means(
        &self,
        run: i64,
        stages: &[Name],
        most_buckets: usize,
    ) -> Result<Vec<StageMeans>, StoreError> {
        read::statistics::means(&self.readers, run, stages, most_buckets).await
    }

    /// What is known of whole runs, in the order asked for; empty of one that is not stored.
    pub async fn statistics(&self, runs: &[i64]) -> Result<Vec<RunStatistics>, StoreError> {
        read::statistics::statistics(&self.readers, runs).await
    }

    /// As [`Store::statistics`], of one run.
    pub async fn statistics_of(&self, run: i64) -> Result<RunStatistics, StoreError> {
        Ok(self.statistics(&[run]).await?.pop().unwrap_or_default())
    }

    /// The distribution of one node name over at most `bins` bins (1 to 500).
    pub async fn histogram(
        &self,
        run: i64,
        stage: &str,
        bins: usize,
    ) -> Result<Option<Histogram>, StoreError> {
        read::statistics::histogram(&self.readers, run, stage, bins).await
    }

    /// Node names over the time of a run, in at most `max_points` buckets of 1, 2, 5, 10, 20, 30, 60 … seconds. Where
    /// retention deleted fine ones of a part of the run, all are made of coarser ones.
    pub async fn series(&self, run: i64, stages: &[Name], max_points: usize) -> Result<Series, StoreError> {
        read::statistics::series(&self.readers, run, stages, max_points).await
    }

    /// Episodes, warm-up and what had no answer, for pictures of a run over time: a few hundred rows at most.
    pub async fn episodes(&self, run: i64) -> Result<Episodes, StoreError> {
        read::episodes::episodes(&self.readers, run).await
    }

    /// The `n` slowest successful iterations (at most 1,000), slowest first.
    pub async fn slowest(&self, run: i64, n: u32) -> Result<Vec<IterationRow>, StoreError> {
        read::iterations::slowest(&self.readers, run, n).await
    }

    /// Iterations by rising number.
    pub async fn iterations(
        &self,
        run: i64,
        filter: &IterationFilter,
    ) -> Result<Vec<IterationRow>, StoreError> {
        read::iterations::iterations(&self.readers, run, filter).await
    }

    /// Two node names in at most `most` iterations, evenly spread over those that are stored: few of a long run are read.
    /// A standard name is the sum of its nodes below the root, one of the users' own its first node, as in `data.csv`.
    pub async fn pairs(&self, run: i64, names: [&str; 2], most: u32) -> Result<Pairs, StoreError> {
        read::pairs::pairs(&self.readers, run, names, most).await
    }

    /// Everything by which a run is judged, its time series in at most 120 buckets.
    pub async fn trust_input(&self, run: &RunDetail) -> Result<TrustInput, StoreError> {
        read::trust::trust_input(&self.readers, run).await
    }

    /// One iteration with its tree.
    pub async fn iteration(&self, run: i64, number: u64) -> Result<Option<IterationDetail>, StoreError> {
        read::iterations::iteration(&self.readers, run, number).await
    }

    /// The next iterations after a number, as the agent sent them, by rising number, and the last number that was
    /// looked at. `None` behind the last iteration.
    pub async fn whole(
        &self,
        run: &RunSummary,
        after: u64,
    ) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
        read::whole::whole(&self.readers, run, after).await
    }

    /// As [`Store::whole`], of a few thousand iterations the first of each shape of tree: they have all columns that a
    /// table of the run needs.
    pub async fn shapes(
        &self,
        run: &RunSummary,
        after: u64,
    ) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
        read::whole::shapes(&self.readers, run, after).await
    }

    /// Incidents, newest first.
    pub async fn incidents(&self, filter: &IncidentFilter) -> Result<Vec<IncidentRow>, StoreError> {
        read::incidents::incidents(&self.readers, filter).await
    }

    /// All hosts by name.
    pub async fn hosts(&self) -> Result<Vec<HostRow>, StoreError> {
        read::incidents::hosts(&self.readers).await
    }

    /// All links by the edge's and the cloud's name and the network.
    pub async fn links(&self) -> Result<Vec<LinkRow>, StoreError> {
        read::clocks::links(&self.readers).await
    }

    /// What was known of a link's clocks from `from` to `to`, on the edge's wall clock, in at most `most_points`
    /// (1 to 10,000) buckets of 1, 2, 5, 10, 30, 60 … seconds. No points for a link that the store does not know.
    pub async fn clock_series(
        &self,
        link: &LinkKey,
        from: WallTime,
        to: WallTime,
        most_points: u32,
    ) -> Result<ClockSeries, StoreError> {
        read::clocks::series(&self.readers, link, (from, to), most_points).await
    }

    /// What the one-way delays of a link rest on, by its newest window. `None` for a link that the store does not know.
    pub async fn link_assumptions(&self, link: &LinkKey) -> Result<Option<DelayAssumptions>, StoreError> {
        read::clocks::of_link(&self.readers, link).await
    }

    /// Judges the one-way delays of a run again, with the exchanges that came after them too. Writes nothing.
    pub async fn recompute(&self, run: i64) -> Result<Option<Recomputed>, StoreError> {
        read::recompute::recompute(&self.readers, run).await
    }
}
