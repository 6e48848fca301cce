//! The aggregator: receives the event streams of all agents. It stores the durable lane (batches of events) in SQLite,
//! and computes the live state from the live lane (live updates) alone.
//!
//! There are four tasks. Each is the only owner of its state, so that no task waits for a lock of another task:
//!
//! ```text
//! agents ── ingest: socket and sessions ─── preparing: batches to rows ── writer: one transaction per group
//!              │  ▲                                                                    │
//!              │  └───────────────────────────────── acknowledgements ─────────────────┤
//!              └─ live lane ── live state ◄──────── stored counts ───────────────────┘
//! ```
//!
//! The live state has constant memory per host and does not depend on the database, so it stays current while the
//! database is slow or closed.
//!
//! Readers get snapshots of the live state with [`Aggregator::live`] and query the [`Store`](peernet_store::Store),
//! which has separate connections. The crate `peernet_store` contains the database and its queries.

mod aggregator;
mod config;
mod error;
mod ingest;
mod live;
mod live_state;
mod readiness;

pub use aggregator::{Aggregator, RunningAggregator};
pub use config::AggregatorConfig;
pub use error::{Failure, Problem, StartError};
pub use live_state::{
    CatchingUp, HostSnapshot, LinkSnapshot, LiveSecond, LiveState, MetricsPoint, PercentilePoint,
    PercentileSeries, PipelineSnapshot, RefusedFrames, RefusedHost, RejectedBatches, Totals, Window,
};
pub use readiness::Readiness;
