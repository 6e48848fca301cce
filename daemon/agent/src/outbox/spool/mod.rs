//! The spool: batches on this host's disk until the aggregator has them.
//!
//! An SQLite file of its own (`migrations/spool`). One task owns the connection and does what the state machine asks
//! for, in order; answers come back over a channel, so that nothing waits for the disk. Each append is one
//! transaction. A crash of the process loses nothing that was appended; a power cut loses at most what was appended
//! since the log was last synced, which is done every sync interval.

mod aside;
mod error;
mod file;
mod inspect;
mod look;
mod open;
mod reserve;
mod statements;
mod sync;
mod tail;
mod tally;
mod task;

#[cfg(test)]
mod tests;

pub(in crate::outbox) use aside::PutAside;
pub use error::{SpoolDefect, SpoolError};
pub use inspect::{InspectError, Inspection, SpoolDamage, SpoolReadError, inspect, waiting_events};
pub(crate) use look::Look;
pub(crate) use open::OpenSpool;
pub(in crate::outbox) use task::{Done, Order, SpoolTask, SpoolTaskError};
