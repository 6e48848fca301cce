//! The agent: what runs on every edge and every cloud.
//!
//! It composes the four modules, which do not know each other: sensors, networks, inference and actuators make
//! [pipelines](config::PipelineConfig); models and a network make a [server](config::ServeConfig). What it
//! measures goes to the aggregator as the event stream of `peernet_stream`: live summaries of each
//! second, and every finished iteration through the outbox. Measuring never waits for storing.
//!
//! ```text
//! pipeline tasks ──┬─ live board ─────┐
//!   (one each)     ├─ feed ───────────┴─ outbox task ── aggregator
//!                  └─ links ── feed ──┤
//! serve, reflector ─────────── feed ──┤
//! host clock, telemetry ──────────────┘
//! ```

mod agent;
mod argument_key;
mod check;
pub mod conditions;
pub mod config;
mod error;
mod event_queue;
mod host;
mod host_clock;
mod identity;
mod incidents;
mod io;
mod link;
mod live;
mod lock;
mod observed;
mod outbox;
mod pipeline;
mod reconnect_backoff;
mod runs;
mod same_clock;
mod serve;
mod tasks;
mod telemetry;

pub use agent::{Agent, Running};
pub use argument_key::{argument_key, share_argument_key};
pub use check::Problem;
pub use config::AgentConfig;
pub use error::{ReflectorError, StartError};
pub use identity::{IdentityError, host_id, host_secret};
pub use incidents::REMARKS;
pub use link::Cloud;
pub use serve::Served;
pub use tasks::{Failure, FailureCause};

/// The file in which events wait for the aggregator.
pub mod spool {
    pub use crate::outbox::{
        InspectError, Inspection, SpoolDamage, SpoolDefect, SpoolError, SpoolReadError, inspect,
        waiting_events,
    };
}
