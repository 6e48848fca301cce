//! What the agent's spool holds, as the state machine knows it. The spool itself, a file, is the agent's.

use bytes::Bytes;
use peernet_clock::WallTime;

use crate::counts::{CountedEvents, Settled};
use crate::totals::{Reached, Totals};
use crate::{Chain, Gap, StreamId, Unresolved};

/// Gaps of earlier processes that are kept apart, at most.
const MOST_UNREPORTED: usize = 64;

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

impl SpoolState {
    /// Takes into account that an earlier process counted these events when they were handed in, of which the spool has
    /// `settled`: what is missing was lost with that process. Returns how many events that are; `None` when it sent batches
    /// that are not in the spool, so that only the aggregator knows what is missing ([`Self::unresolved`]).
    ///
    /// The number is exact; a run that was not counted separately leaves its losses to a gap that names no run.
    pub fn lose_tail(&mut self, counted: CountedEvents, settled: Settled) -> Option<u64> {
        if self.unresolved.is_none() && counted.may_be_stored(&settled, &self.totals) {
            self.unresolved = Some(Unresolved::new(counted, settled, &self.totals));
            return None;
        }
        let lost = counted.all.saturating_sub(settled.events.all);
        for gap in counted.gaps(&settled, 0, lost) {
            self.lose(gap);
        }
        self.totals.produced += lost;
        self.totals.dropped += lost;
        Some(lost)
    }

    fn lose(&mut self, lost: Gap) {
        let same = |gap: &&mut Gap| {
            (&gap.pipeline, gap.run, &gap.reason) == (&lost.pipeline, lost.run, &lost.reason)
        };
        let merge = |gap: &mut Gap| {
            gap.count += lost.count;
            (gap.from, gap.to) = (gap.from.min(lost.from), gap.to.max(lost.to));
        };
        if let Some(gap) = self.unreported.iter_mut().find(same) {
            return merge(gap);
        }
        let full = self.unreported.len() >= MOST_UNREPORTED;
        match self.unreported.last_mut().filter(|_| full) {
            Some(gap) => {
                (gap.pipeline, gap.run) = (None, None);
                merge(gap);
            }
            None => self.unreported.push(lost),
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_logger::RunId;

    use super::*;
    use crate::{CountedRun, RunCounts};

    fn at(seconds: i64) -> WallTime {
        WallTime::from_unix_nanos(seconds * 1_000_000_000)
    }

    fn counted(all: u64, runs: &[(RunId, u64)]) -> CountedEvents {
        let run = |&(run, events)| CountedRun { run, pipeline: "line".parse().ok(), events, last: at(9) };
        CountedEvents { all, last: at(10), sent: Vec::new(), runs: runs.iter().map(run).collect() }
    }

    fn settled(all: u64, runs: &[(RunId, u64)], last: Option<WallTime>) -> Settled {
        Settled { events: RunCounts { all, runs: runs.iter().copied().collect() }, taken: all, last }
    }

    #[test]
    fn lost_tail_is_split_by_run() {
        let (first, second, ended) = (RunId::random(), RunId::random(), RunId::random());
        let mut state = SpoolState::new(StreamId::random());
        state.totals.produced = 100;
        let counted = counted(115, &[(first, 70), (second, 4)]);
        let settled = settled(100, &[(first, 60), (ended, 30)], Some(at(8)));
        assert_eq!(state.lose_tail(counted.clone(), settled), Some(15));
        assert_eq!((state.totals.produced, state.totals.dropped, state.totals.told), (115, 15, 0));
        let gaps: Vec<_> =
            state.unreported.iter().map(|gap| (gap.run, gap.count, gap.from, gap.to)).collect();
        let expected =
            [(Some(first), 10, at(8), at(9)), (Some(second), 4, at(8), at(9)), (None, 1, at(8), at(10))];
        assert_eq!(gaps, expected);
        // Another process that is killed at once changes only how many they are.
        let next = CountedEvents { all: 2, ..counted };
        assert_eq!(state.lose_tail(next, Settled::default()), Some(2));
        assert_eq!((state.unreported.len(), state.unreported[0].count), (3, 12));
    }

    #[test]
    fn nothing_is_lost_when_everything_is_settled() {
        let (run, mut state) = (RunId::random(), SpoolState::new(StreamId::random()));
        let settled = settled(7, &[(run, 5)], None);
        assert_eq!(state.lose_tail(counted(7, &[(run, 5)]), settled.clone()), Some(0));
        // A counter that is behind the spool proves nothing.
        assert_eq!(state.lose_tail(counted(3, &[(run, 6)]), settled), Some(0));
        assert_eq!(state, SpoolState::new(state.stream));
    }

    #[test]
    fn many_losses_of_earlier_processes_stay_few_gaps() {
        let mut state = SpoolState::new(StreamId::random());
        for _ in 0..500 {
            let run = RunId::random();
            state.lose_tail(counted(3, &[(run, 3)]), Settled::default());
        }
        assert_eq!(state.unreported.len(), MOST_UNREPORTED);
        assert_eq!(state.unreported.iter().map(|gap| gap.count).sum::<u64>(), 1_500);
    }
}
