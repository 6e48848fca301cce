//! The aggregator: receives the event stream of all agents, stores its durable lane in SQLite, and keeps the
//! live picture from its live lane alone.
//!
//! Four tasks, each the only owner of its state:
//!
//! ```text
//! agents ── ingest: socket and session, who may speak ── preparing: batches to rows ── writer: one transaction a group
//!              │  ▲                                                                    │
//!              │  └───────────────────────────────── acknowledgements ─────────────────┤
//!              └─ live lane ── live picture ◄──────── what is stored now ──────────────┘
//! ```
//!
//! Readers get snapshots of the picture by [`Aggregator::live`] and ask the [`Store`](peernet_store::Store) over connections of their own.
//! The database, and all that is asked of it, is the crate `peernet_store`.

mod aggregator;
mod config;
mod error;
mod ingest;
mod live;
mod picture;
mod readiness;

pub use aggregator::{Aggregator, Running};
pub use config::AggregatorConfig;
pub use error::{Failure, Problem, StartError};
pub use picture::{
    Arrivals, CatchingUp, HostPicture, LinkPicture, LiveSecond, MetricsPoint, PercentilePoint,
    PercentileSeries, Picture, PipelinePicture, RefusedFrames, RefusedHost, Totals, Window,
};
pub use readiness::Readiness;
