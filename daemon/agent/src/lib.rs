//! The agent: the part of PEERNet that runs on every edge and every cloud.
//!
//! The agent composes the four modules of the paper, which do not depend on each other. A sensor, a network, a model
//! and an actuator form a [pipeline](config::PipelineConfig); models and a network form a
//! [server](config::ServeConfig). The agent sends its measurements to the aggregator as the event stream of
//! `peernet_stream`: a live summary of each second, and every finished iteration through the outbox. Measuring never
//! waits for storing.
//!
//! ```text
//! pipeline tasks ──┬─ live statistics ───┐
//!   (one each)     ├─ event queue ───────┴─ outbox task ── aggregator
//!                  └─ links ── event queue ─┤
//! serve, reflector ─────────── event queue ─┤
//! host clock, telemetry ────────────────────┘
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

pub use agent::{Agent, RunningAgent};
pub use argument_key::{argument_key, share_argument_key};
pub use check::Problem;
pub use config::AgentConfig;
pub use error::{ReflectorError, StartError};
pub use event_queue::{MissedEventCounters, MissedEvents};
pub use identity::{IdentityError, host_id, host_secret};
pub use incidents::REMARK_LOG_TARGET;
pub use link::Cloud;
pub use outbox::reach_aggregator;
pub use serve::ServedCounts;
pub use tasks::{Failure, FailureCause};

/// The spool: the file in which events wait until the aggregator has stored them.
pub mod spool {
    pub use crate::outbox::{
        InspectError, Inspection, SpoolDamage, SpoolDefect, SpoolError, SpoolReadError, inspect,
        pending_events,
    };
}
