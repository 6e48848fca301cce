//! The spool: batches on this host's disk until the aggregator has stored them.
//!
//! The spool is a separate SQLite file (`migrations/spool`). One task owns the connection and executes the requests of
//! the state machine one after the other. The results are sent over a channel, so that no other task waits for the
//! disk. Each append is one transaction, which also updates the totals, so that batches and totals agree whenever the
//! process is killed.
//!
//! A crash of the process loses no appended batch. A power cut loses at most the batches that were appended since
//! SQLite's write-ahead log was last synced. The log is synced every sync interval and not after each batch. By
//! default up to five batches per second are due, and five syncs per second wear out the flash memory of a robot.

mod error;
mod file;
mod file_kind;
mod inspect;
mod killed_process;
mod open;
mod quarantine;
mod range_log;
mod recovery;
mod reserve;
mod statements;
mod sync;
mod task;

#[cfg(test)]
mod tests;

pub use error::{SpoolDefect, SpoolError};
pub(crate) use file_kind::FileKind;
pub use inspect::{InspectError, Inspection, SpoolDamage, SpoolReadError, inspect, pending_events};
pub(crate) use open::OpenSpool;
pub(in crate::outbox) use quarantine::QuarantinedSpool;
pub(in crate::outbox) use recovery::RecoveryCounts;
pub(in crate::outbox) use task::{SpoolRequest, SpoolResult, SpoolTask, SpoolTaskError};
