//! Content of the agent's spool as known to the state machine. The file itself belongs to the agent.

use bytes::Bytes;
use peernet_clock::WallTime;

use crate::counts::{CountedEvents, SettledEvents};
use crate::totals::{NewestSendableBatch, Totals};
use crate::{ChainHash, Gap, StreamId, UnresolvedBatches};

/// Maximum number of gaps of earlier processes that are kept separately. Further gaps are merged.
const MAX_UNREPORTED: usize = 64;

/// A number of events and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Number of events.
    pub events: u64,
    /// Number of bytes in wire form.
    pub bytes: u64,
}

impl Usage {
    /// Returns whether both numbers are within a limit.
    pub(super) const fn fits(self, limit: Self) -> bool {
        self.events <= limit.events && self.bytes <= limit.bytes
    }
}

impl std::ops::Sub for Usage {
    type Output = Self;
    /// Subtracts both numbers; saturates at zero.
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

/// A batch in the spool: events encoded one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpooledBatch {
    /// Number of the batch, contiguous within the stream and never used twice.
    pub number: u64,
    /// Time of the batch's first event on the agent's wall clock.
    pub since: WallTime,
    /// Number of events.
    pub events: u32,
    /// Chain hash of the batch.
    pub chain: ChainHash,
    /// Wire forms of the events.
    pub body: Bytes,
}

impl SpooledBatch {
    /// Returns the number of events and bytes of the batch.
    pub(super) fn usage(&self) -> Usage {
        Usage { events: u64::from(self.events), bytes: self.body.len() as u64 }
    }
}

/// State of a spool when it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpoolState {
    /// Stream that the spool's batches belong to.
    pub stream: StreamId,
    /// Stream that `stream` replaced.
    pub previous_stream: Option<StreamId>,
    /// Number of the stream's first batch.
    pub first: u64,
    /// Number of events in all batches before the stream's first batch; `None` if it is unknown.
    pub events_before_first: Option<u64>,
    /// Number of the oldest batch in the spool; the number after the newest batch if the spool contains none.
    pub oldest: u64,
    /// Chain hash of the batch before the oldest.
    pub chain_before_oldest: ChainHash,
    /// Number and chain hash of the newest batch that was ever written.
    pub newest: (u64, ChainHash),
    /// Time of the first event of the oldest batch.
    pub since: Option<WallTime>,
    /// Number of events and bytes in the spool.
    pub waiting_usage: Usage,
    /// Totals up to the newest batch.
    pub totals: Totals,
    /// Newest batch that each process was allowed to send from this spool. A process that is not listed is assumed to
    /// have sent from a copy of the spool.
    pub newest_sendable: Vec<NewestSendableBatch>,
    /// Gaps of earlier processes that are not reported yet: for events that were dropped, or lost when a process was
    /// killed.
    pub unreported: Vec<Gap>,
    /// The last batches of an earlier process, if only the aggregator knows whether these batches are stored. No loss
    /// is reported before the aggregator has stated this.
    pub unresolved: Option<UnresolvedBatches>,
}

impl SpoolState {
    /// Creates the state of a new spool.
    pub fn new(stream: StreamId) -> Self {
        Self {
            stream,
            previous_stream: None,
            first: 1,
            events_before_first: Some(0),
            oldest: 1,
            chain_before_oldest: ChainHash::START,
            newest: (0, ChainHash::START),
            since: None,
            waiting_usage: Usage::default(),
            totals: Totals::default(),
            newest_sendable: Vec::new(),
            unreported: Vec::new(),
            unresolved: None,
        }
    }
}

impl SpoolState {
    /// Records the losses of an earlier process. `counted` are the events that were submitted to that process;
    /// `settled` are those events that are in the spool or counted as dropped. The other events were lost when the
    /// process was killed. Returns the number of lost events; `None` if the process sent batches that are not in the
    /// spool, so only the aggregator knows which events are lost ([`Self::unresolved`]).
    ///
    /// The total is exact. The losses of a run that was not counted separately are reported in a gap without a run.
    pub fn record_losses_of_killed_process(
        &mut self,
        counted: CountedEvents,
        settled: SettledEvents,
    ) -> Option<u64> {
        // The state has the unresolved batches of one process only. Such batches of a further process count as lost.
        if self.unresolved.is_none() && counted.may_be_stored(&settled, &self.totals) {
            self.unresolved = Some(UnresolvedBatches::new(counted, settled, &self.totals));
            return None;
        }
        let lost = counted.total.saturating_sub(settled.events.total);
        // All events that are not settled count as lost.
        let accounted = 0;
        for gap in counted.gaps(&settled, accounted, lost) {
            self.add_loss(gap);
        }
        self.totals.produced += lost;
        self.totals.dropped += lost;
        Some(lost)
    }

    fn add_loss(&mut self, lost: Gap) {
        let has_same_cause = |gap: &&mut Gap| {
            (&gap.pipeline, gap.run, &gap.reason) == (&lost.pipeline, lost.run, &lost.reason)
        };
        let merge = |gap: &mut Gap| {
            gap.count += lost.count;
            (gap.from, gap.to) = (gap.from.min(lost.from), gap.to.max(lost.to));
        };
        // An agent that is killed again and again would otherwise add a gap each time.
        if let Some(gap) = self.unreported.iter_mut().find(has_same_cause) {
            return merge(gap);
        }
        let is_full = self.unreported.len() >= MAX_UNREPORTED;
        match self.unreported.last_mut().filter(|_| is_full) {
            Some(gap) => {
                // The merged gap covers several runs.
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

    fn counted(total: u64, runs: &[(RunId, u64)]) -> CountedEvents {
        let run = |&(run, events)| CountedRun { run, pipeline: "line".parse().ok(), events, last: at(9) };
        CountedEvents { total, last: at(10), sent: Vec::new(), runs: runs.iter().map(run).collect() }
    }

    fn settled(total: u64, runs: &[(RunId, u64)], last: Option<WallTime>) -> SettledEvents {
        SettledEvents {
            events: RunCounts { total, runs: runs.iter().copied().collect() },
            batched: total,
            last,
        }
    }

    #[test]
    fn losses_of_killed_process_are_split_by_run() {
        let (first, second, ended) = (RunId::random(), RunId::random(), RunId::random());
        let mut state = SpoolState::new(StreamId::random());
        state.totals.produced = 100;
        let counted = counted(115, &[(first, 70), (second, 4)]);
        let settled = settled(100, &[(first, 60), (ended, 30)], Some(at(8)));
        assert_eq!(state.record_losses_of_killed_process(counted.clone(), settled), Some(15));
        assert_eq!((state.totals.produced, state.totals.dropped, state.totals.reported_drops), (115, 15, 0));
        let gaps: Vec<_> =
            state.unreported.iter().map(|gap| (gap.run, gap.count, gap.from, gap.to)).collect();
        let expected =
            [(Some(first), 10, at(8), at(9)), (Some(second), 4, at(8), at(9)), (None, 1, at(8), at(10))];
        assert_eq!(gaps, expected);
        // The next process, which is killed at once, adds only its own events.
        let next = CountedEvents { total: 2, ..counted };
        assert_eq!(state.record_losses_of_killed_process(next, SettledEvents::default()), Some(2));
        assert_eq!((state.unreported.len(), state.unreported[0].count), (3, 12));
    }

    #[test]
    fn no_loss_is_recorded_if_all_events_are_settled() {
        let (run, mut state) = (RunId::random(), SpoolState::new(StreamId::random()));
        let settled = settled(7, &[(run, 5)], None);
        assert_eq!(state.record_losses_of_killed_process(counted(7, &[(run, 5)]), settled.clone()), Some(0));
        // A counter that is behind the spool proves no loss.
        assert_eq!(state.record_losses_of_killed_process(counted(3, &[(run, 6)]), settled), Some(0));
        assert_eq!(state, SpoolState::new(state.stream));
    }

    #[test]
    fn losses_of_many_processes_are_merged_into_few_gaps() {
        let mut state = SpoolState::new(StreamId::random());
        for _ in 0..500 {
            let run = RunId::random();
            state.record_losses_of_killed_process(counted(3, &[(run, 3)]), SettledEvents::default());
        }
        assert_eq!(state.unreported.len(), MAX_UNREPORTED);
        assert_eq!(state.unreported.iter().map(|gap| gap.count).sum::<u64>(), 1_500);
    }
}
