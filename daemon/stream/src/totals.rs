//! Counts since a spool was created, and the newest batch that each process is allowed to send.

use crate::Gap;
use crate::counts::SubmittedEvents;

/// Newest batch that a process is allowed to send.
///
/// The record is written to the spool's file before the process sends the batch, so the process has not necessarily
/// sent it. If the aggregator has a later batch of the recorded process, it has also stored all batches of the file up
/// to this number: the recorded process or an earlier process sent them, and the aggregator stores the batches of a
/// stream in order. The file then lost its newest batches (a power failure, a failed disk), or is an older copy. A batch
/// of a process that is not recorded in the file proves nothing about the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewestSendableBatch {
    /// Random number of the process ([`super::Hello::process`]).
    pub process: u64,
    /// Number of the newest batch that the process is allowed to send.
    pub number: u64,
}

/// Counts since the spool was created. The counts are written in the same transaction as the batches, so that counts
/// and batches agree whenever the process is killed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Number of events that were submitted. Reported gaps count as events, too.
    pub produced: u64,
    /// Number of events that were dropped.
    pub dropped: u64,
    /// Number of gaps that were reported.
    pub gaps: u64,
    /// Number of dropped events that gaps have reported. Gaps must still report all other dropped events, also after a
    /// restart.
    pub reported_drops: u64,
    /// Events that were submitted to the current process.
    pub submitted: SubmittedEvents,
    /// Newest batch that the current process is allowed to send; `None` before the aggregator has accepted the process.
    /// If `None`, the records in the spool stay unchanged.
    pub newest_sendable: Option<NewestSendableBatch>,
    /// Losses that no gap reports yet; `None` if the losses in the spool stay unchanged. `Some` also means that
    /// [`SpoolState::unresolved`](crate::SpoolState::unresolved) is resolved.
    pub unreported: Option<Vec<Gap>>,
}
