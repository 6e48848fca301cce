//! What the agent's spool holds, as the state machine knows it. The spool itself, a file, is the agent's.

use bytes::Bytes;
use peernet_clock::WallTime;

use super::counts::HandedIn;
use super::{Chain, Gap, StreamId, Unresolved};

/// Events and the bytes they take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// How many events.
    pub events: u64,
    /// Their bytes in wire form.
    pub bytes: u64,
}

impl Usage {
    /// Whether both are within a limit.
    pub(super) const fn fits(self, limit: Self) -> bool {
        self.events <= limit.events && self.bytes <= limit.bytes
    }
}

impl std::ops::Sub for Usage {
    type Output = Self;
    /// Saturates at zero.
    fn sub(self, other: Self) -> Self {
        let (events, bytes) =
            (self.events.saturating_sub(other.events), self.bytes.saturating_sub(other.bytes));
        Self { events, bytes }
    }
}

impl std::ops::Add for Usage {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (events, bytes) =
            (self.events.saturating_add(other.events), self.bytes.saturating_add(other.bytes));
        Self { events, bytes }
    }
}

/// A batch as it is kept: the events encoded one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpooledBatch {
    /// Contiguous within the stream; never used twice.
    pub number: u64,
    /// When its first event came, on the agent's wall clock.
    pub since: WallTime,
    /// How many events.
    pub events: u32,
    /// Chain of this batch.
    pub chain: Chain,
    /// Wire forms of the events.
    pub body: Bytes,
}

impl SpooledBatch {
    /// What it takes.
    pub(super) fn usage(&self) -> Usage {
        Usage { events: u64::from(self.events), bytes: self.body.len() as u64 }
    }
}

/// What a spool knows when it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpoolState {
    /// The stream that its numbers belong to.
    pub stream: StreamId,
    /// The stream that this one replaced.
    pub previous: Option<StreamId>,
    /// Number of the stream's first batch.
    pub first: u64,
    /// Number of events in all batches before that; `None` when it is not known.
    pub events_before_first: Option<u64>,
    /// Number of the oldest batch held; one more than the newest when none is.
    pub oldest: u64,
    /// Chain of the batch before the oldest.
    pub before: Chain,
    /// Chain of the newest batch ever written; `before` when none is held.
    pub newest: (u64, Chain),
    /// When the first event of the oldest batch came.
    pub since: Option<WallTime>,
    /// What is held.
    pub held: Usage,
    /// What was counted up to the newest batch.
    pub totals: Totals,
    /// How far the processes came that sent from this spool. It need not be all of them: a process that is forgotten
    /// counts as one of a copy of the spool.
    pub reached: Vec<Reached>,
    /// Events of earlier processes that were dropped or lost with them, and that no gap reports yet.
    pub unreported: Vec<Gap>,
    /// The end of an earlier process of which only the aggregator knows what is stored. No loss is reported before that is
    /// known.
    pub unresolved: Option<Unresolved>,
}

impl SpoolState {
    /// A spool that was made just now.
    pub fn new(stream: StreamId) -> Self {
        Self {
            stream,
            previous: None,
            first: 1,
            events_before_first: Some(0),
            oldest: 1,
            before: Chain::START,
            newest: (0, Chain::START),
            since: None,
            held: Usage::default(),
            totals: Totals::default(),
            reached: Vec::new(),
            unreported: Vec::new(),
            unresolved: None,
        }
    }
}

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
