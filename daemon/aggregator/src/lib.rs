//! The aggregator: receives the event stream of all agents, stores its durable lane in SQLite, and keeps the
//! live picture from its live lane alone.
//!
//! Three tasks, each the only owner of its state: `ingest` owns the socket and decides who may speak, the
//! writer owns the database's one writing connection, and `live` owns the picture. Readers get snapshots of
//! the picture by [`Aggregator::live`] and ask the [`Store`] over connections of their own.

mod aggregator;
mod config;
mod error;
mod figures;
mod ingest;
mod live;
mod picture;
mod plausible;
mod store;

pub use aggregator::{Aggregator, Readiness, Running};
pub use config::{AggregatorConfig, RetentionConfig};
pub use error::{Failure, Problem, StartError, StoreError};
pub use figures::{Bound, Figures, P95_NEEDS, P99_NEEDS, rank};
pub use picture::{
    Arrivals, CatchingUp, ClockPoint, HostPicture, LinkPicture, LiveSecond, MetricsPoint, Picture,
    PipelinePicture, RefusedFrames, RefusedHost, Stored, Totals, Window,
};
pub use store::lock::{DatabaseLock, LockError};
pub use store::types::{
    BOTH_WAYS, Blame, ClockSeries, DelayRow, ExperimentSummary, GapRow, Histogram, HostRow, IncidentRow,
    IterationDetail, IterationFilter, IterationRow, Judgement, LinkRow, Recomputed, RecomputedStage,
    RunDetail, RunFilter, RunSummary, Series, SeriesPoint, StageCourse, StageSeries, StageStatistics,
};
pub use store::{Store, maintenance};
