//! Counts since a spool was made, and the newest batch of each process.

use crate::Gap;
use crate::counts::HandedIn;

/// How far a process came.
///
/// It is written before anything is sent, with the number of the process that will send it. What is in the file up to
/// this number is what that process sent under these numbers, or was sent before it. So when the aggregator has a later
/// batch of that process, all of it is stored: the file lost its end (a power cut, a disk that failed), or is a copy
/// of before. When the aggregator has a batch of a process that the file does not know, nothing is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reached {
    /// The process ([`super::Hello::process`]).
    pub process: u64,
    /// Number of the newest batch that it may have sent.
    pub number: u64,
}

/// Counted since the spool was made; all of it is kept with the batches, so that they agree whenever the
/// process is killed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Events that were handed in.
    pub produced: u64,
    /// Events that were dropped.
    pub dropped: u64,
    /// Gaps that were reported.
    pub gaps: u64,
    /// Of the events that were dropped, those that stand in a gap: the others are still to be told, after a restart as well.
    pub told: u64,
    /// Events that were handed in to the process at hand.
    pub handed_in: HandedIn,
    /// How far the process at hand comes with this; `None` while it has not met the aggregator: what the spool says of
    /// it and of others then stays.
    pub reached: Option<Reached>,
    /// With it, [`SpoolState::unresolved`] is resolved, and these are the losses which no gap reports yet.
    pub unreported: Option<Vec<Gap>>,
}
