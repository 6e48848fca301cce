//! The spool: batches on this host's disk until the aggregator has stored them.
//!
//! It is a separate SQLite file (`migrations/spool`). One task owns the connection and executes the orders of the
//! state machine one after the other; results come back over a channel, so that nothing else waits for the disk. Each
//! append is one transaction, which also updates the totals, so that both agree whenever the process is killed.
//!
//! A crash of the process loses nothing that was appended. A power cut loses at most the appends since the log was
//! last synced: it is synced every sync interval and not at each batch, because the flash of a robot is not made for
//! five syncs per second.

mod aside;
mod error;
mod file;
mod file_kind;
mod inspect;
mod open;
mod reserve;
mod statements;
mod sync;
mod tail;
mod tally;
mod task;

#[cfg(test)]
mod tests;

pub(in crate::outbox) use aside::QuarantinedSpool;
pub use error::{SpoolDefect, SpoolError};
pub(crate) use file_kind::FileKind;
pub use inspect::{InspectError, Inspection, SpoolDamage, SpoolReadError, inspect, pending_events};
pub(crate) use open::OpenSpool;
pub(in crate::outbox) use task::{Done, Order, SpoolTask, SpoolTaskError};
