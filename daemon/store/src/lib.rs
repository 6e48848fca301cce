//! The store: the aggregator's SQLite database. It is the only crate that contains SQL for this database.
//!
//! [`Store`] serves queries over read-only connections. `write` stores batches, `retention` deletes
//! old data between commits, and `maintenance` holds the commands that an operator applies to the file.

mod column;
pub(crate) mod database;
mod database_error;
mod error;
mod extent;
pub(crate) mod file_kind;
pub(crate) mod foreign_log;
mod incidents;
mod insert;
mod integrity;
mod limits;
mod lock;
pub mod maintenance;
mod opening;
pub mod plausible;
mod quantity_statistics;
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
pub use lock::{DatabaseLock, LockError};
pub use quantity_statistics::{DelayAccuracy, QuantityStatistics, SENSING_CHILDREN, table_order};
pub use retention_config::RetentionConfig;
pub use stored::{ClockPoint, StoredCounts};
pub use types::{
    AggregatorIncidentKind, ClockSeries, DelayAssumptions, DelayRow, Episodes, ExperimentSummary, GapRow,
    Histogram, HostRow, IncidentFilter, IncidentRow, IterationDetail, IterationFilter, IterationRow,
    Judgement, LinkKey, LinkRow, MeanBucket, MeasuredTime, MeasuredWithin, MergeableStatistics,
    RecomputedDelays, RecomputedStage, RunDetail, RunFilter, RunStatistics, RunSummary, Series, SeriesPoint,
    StageBuckets, StageMeans, StageSeries, StageStatistics, ValuePairs,
};

/// Types for the one process that writes to the database.
pub mod writing {
    pub use crate::integrity::Integrity;
    pub use crate::opening::{OpenDatabase, ReopenError, StoredState};
    pub use crate::readers::Readers;
    pub use crate::retention::StepResult;
    pub use crate::write::{
        CommitError, CommitResult, ConnectionSample, FormerFiles, Introduction, LiveRunDescription,
        PendingIncidents, Streams, UnstorableBatch, Work, Writer,
    };
}

/// Read-only access to the database. It has its own connections and never blocks the writer.
#[derive(Clone, Debug)]
pub struct Store {
    readers: Readers,
}

impl Store {
    /// Creates a store that queries over these connections.
    pub fn new(readers: Readers) -> Self {
        Self { readers }
    }

    /// Stops the queries in progress and closes the connections. Later queries are refused.
    pub async fn close(&self) {
        self.readers.close().await;
    }

    /// Opens new connections in place of the closed connections, so that queries work again.
    pub fn reopen(&self) {
        self.readers.reopen();
    }

    /// Returns runs, newest first.
    ///
    /// # Errors
    /// When the database cannot be read. This applies to all queries of the store.
    pub async fn runs(&self, filter: &RunFilter) -> Result<Vec<RunSummary>, StoreError> {
        read::runs::runs(&self.readers, filter).await
    }

    /// Returns one run, or `None` when no run has this number.
    pub async fn run(&self, number: i64) -> Result<Option<RunDetail>, StoreError> {
        read::runs::run(&self.readers, number).await
    }

    /// Returns at most `limit` (1 to 1,000) runs of an experiment, oldest first. An unknown experiment has no runs.
    pub async fn runs_of_experiment(&self, id: &str, limit: u32) -> Result<Vec<RunSummary>, StoreError> {
        read::runs::runs_of_experiment(&self.readers, id, limit).await
    }

    /// Returns at most `limit` (1 to 1,000) experiments. The experiment with the newest run comes first.
    pub async fn experiments(&self, limit: u32) -> Result<Vec<ExperimentSummary>, StoreError> {
        read::runs::experiments(&self.readers, limit).await
    }

    /// Divides the time of a run into at most `max_buckets` buckets, and returns for each node name the summaries of
    /// its values in these buckets. The result is in the order of `stages`; names without values are omitted.
    pub async fn stage_buckets(
        &self,
        run: i64,
        stages: &[Name],
        max_buckets: usize,
    ) -> Result<Vec<StageBuckets>, StoreError> {
        read::statistics::stage_buckets(&self.readers, run, stages, max_buckets).await
    }

    /// Returns counts and means over the time of a run, in the buckets of [`Store::stage_buckets`]. This query reads no
    /// sketches and therefore takes a tenth of the time of `stage_buckets`.
    pub async fn stage_means(
        &self,
        run: i64,
        stages: &[Name],
        max_buckets: usize,
    ) -> Result<Vec<StageMeans>, StoreError> {
        read::statistics::stage_means(&self.readers, run, stages, max_buckets).await
    }

    /// Returns the statistics of whole runs, in the order of `runs`. The statistics of a run that is not stored are
    /// empty.
    pub async fn statistics(&self, runs: &[i64]) -> Result<Vec<RunStatistics>, StoreError> {
        read::statistics::statistics(&self.readers, runs).await
    }

    /// Returns the statistics of one run, as [`Store::statistics`] does.
    pub async fn statistics_of(&self, run: i64) -> Result<RunStatistics, StoreError> {
        Ok(self.statistics(&[run]).await?.pop().unwrap_or_default())
    }

    /// Returns the distribution of the values of one node name, in at most `bins` bins
    /// ([`Binning`](peernet_statistics::histogram::Binning)). `None` if the run has no values of this name.
    pub async fn histogram(
        &self,
        run: i64,
        stage: &str,
        bins: usize,
    ) -> Result<Option<Histogram>, StoreError> {
        read::statistics::histogram(&self.readers, run, stage, bins).await
    }

    /// Returns the values of node names over the time of a run, in at most `max_points` buckets of 1, 2, 5, 10, 20, 30,
    /// 60 … seconds. If retention deleted the fine buckets of a part of the run, all points of the run are made from
    /// coarser buckets.
    pub async fn series(&self, run: i64, stages: &[Name], max_points: usize) -> Result<Series, StoreError> {
        read::statistics::series(&self.readers, run, stages, max_points).await
    }

    /// Returns episodes, periods of warm-up, and failed iterations for charts of a run over time. Each list has at most
    /// a few hundred entries.
    pub async fn episodes(&self, run: i64) -> Result<Episodes, StoreError> {
        read::episodes::episodes(&self.readers, run).await
    }

    /// Returns the `n` slowest successful iterations (at most 1,000), slowest first.
    pub async fn slowest_iterations(&self, run: i64, n: u32) -> Result<Vec<IterationRow>, StoreError> {
        read::iterations::slowest_iterations(&self.readers, run, n).await
    }

    /// Returns iterations in the order of their numbers.
    pub async fn iterations(
        &self,
        run: i64,
        filter: &IterationFilter,
    ) -> Result<Vec<IterationRow>, StoreError> {
        read::iterations::iterations(&self.readers, run, filter).await
    }

    /// Returns the values of two node names in at most `max_pairs` iterations, evenly spread over the stored
    /// iterations.
    ///
    /// The value of a standard name is the sum of the nodes of this name directly below the root, as in `data.csv`. The
    /// value of a custom name is the sum of all its nodes. At most `max_pairs` iterations are read, however long the
    /// run is.
    pub async fn value_pairs(
        &self,
        run: i64,
        names: [&str; 2],
        max_pairs: u32,
    ) -> Result<ValuePairs, StoreError> {
        read::pairs::value_pairs(&self.readers, run, names, max_pairs).await
    }

    /// Returns the time in which a run measured. `None` if the run has no successful iteration after the warm-up, or if
    /// too little of the run is still stored to know this time.
    pub async fn measured_time(&self, run: &RunSummary) -> Result<Option<MeasuredTime>, StoreError> {
        read::measured_time::measured_time(&self.readers, run).await
    }

    /// Returns the number of the iterations of a run that started at `from` or later and before `to`, and the
    /// distribution of their values of `total`. Both times must be multiples of the
    /// [resolution](MeasuredTime::resolution_s), unless the resolution is 0. The number is exact; quantiles of the
    /// distribution are within 1 %.
    pub async fn measured_within(
        &self,
        run: i64,
        from: WallTime,
        to: WallTime,
    ) -> Result<MeasuredWithin, StoreError> {
        read::measured_time::measured_within(&self.readers, run, (from, to)).await
    }

    /// Returns the values from which the trust findings of a run are computed, with time series of at most 120 buckets.
    pub async fn trust_input(&self, run: &RunDetail) -> Result<TrustInput, StoreError> {
        read::trust::trust_input(&self.readers, run).await
    }

    /// Returns one iteration with its tree.
    pub async fn iteration(&self, run: i64, number: u64) -> Result<Option<IterationDetail>, StoreError> {
        read::iterations::iteration(&self.readers, run, number).await
    }

    /// Returns the next iterations after a number, at most 200, as the agent sent them, in the order of their numbers.
    /// The number in the result is the number of the last examined iteration; the caller passes it as `after` to the
    /// next call. Returns `None` after the last iteration.
    pub async fn full_iterations(
        &self,
        run: &RunSummary,
        after: u64,
    ) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
        read::whole::full_iterations(&self.readers, run, after).await
    }

    /// Returns the first iteration of each shape of tree among the next few thousand iterations, or among fewer
    /// iterations if these have more shapes than one result can have. Arguments and result are those of
    /// [`Store::full_iterations`]. The nodes of the returned iterations determine all columns that a table of the
    /// examined iterations needs.
    pub async fn iterations_by_shape(
        &self,
        run: &RunSummary,
        after: u64,
    ) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
        read::whole::iterations_by_shape(&self.readers, run, after).await
    }

    /// Returns incidents, newest first.
    pub async fn incidents(&self, filter: &IncidentFilter) -> Result<Vec<IncidentRow>, StoreError> {
        read::incidents::incidents(&self.readers, filter).await
    }

    /// Returns all hosts that have introduced themselves, ordered by name. Of several hosts with one name, the host that
    /// was seen last is first.
    pub async fn hosts(&self) -> Result<Vec<HostRow>, StoreError> {
        read::incidents::hosts(&self.readers).await
    }

    /// Returns the first of [`hosts`](Self::hosts) that has this name or id.
    pub async fn host(&self, name_or_id: &str) -> Result<Option<HostRow>, StoreError> {
        let mut hosts = self.hosts().await?.into_iter();
        Ok(hosts.find(|host| host.name.as_str() == name_or_id || host.id.to_string() == name_or_id))
    }

    /// Returns all links, ordered by the edge's name, the cloud's name and the network. Of several links with one name,
    /// the link with the newest clock sample is first.
    pub async fn links(&self) -> Result<Vec<LinkRow>, StoreError> {
        read::clocks::links(&self.readers).await
    }

    /// Returns the clock relation of a link from `from` to `to`, on the edge's wall clock, in at most `max_points`
    /// (1 to 10,000) buckets of 1, 2, 5, 10, 20, 30, 60 … seconds. The result has no points for an unknown link.
    pub async fn clock_series(
        &self,
        link: &LinkKey,
        from: WallTime,
        to: WallTime,
        max_points: u32,
    ) -> Result<ClockSeries, StoreError> {
        read::clocks::series(&self.readers, link, (from, to), max_points).await
    }

    /// Returns the assumptions behind the one-way delays of a link's newest relation period, or `None` for an unknown
    /// link.
    pub async fn link_assumptions(&self, link: &LinkKey) -> Result<Option<DelayAssumptions>, StoreError> {
        read::clocks::link_assumptions(&self.readers, link).await
    }

    /// Judges the one-way delays of a run again, from all stored exchanges, including exchanges that took place after
    /// the messages of these delays. `None` for an unknown run. Writes nothing.
    pub async fn recompute(&self, run: i64) -> Result<Option<RecomputedDelays>, StoreError> {
        read::recompute::recompute(&self.readers, run).await
    }
}
