//! Events that are handed in, counted by run: what a process that was killed took with it is known by them.

use std::collections::BTreeMap;

use peernet_clock::WallTime;

use super::spool::SpoolState;
use super::unresolved::{SentUnspooled, Unresolved};
use super::{Event, Gap};
use peernet_logger::{RunId, Slug};

/// Runs that are counted separately, at most: one a pipeline, and some that have just ended.
pub const MOST_COUNTED_RUNS: usize = 256;

/// Reason of the gap that takes the place of the events which were lost with their process.
pub const KILLED: &str = "the agent was killed before these events reached its spool";

/// Gaps of earlier processes that are kept apart, at most.
const MOST_UNREPORTED: usize = 64;

/// Numbers of events: of all, and of each run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunCounts {
    /// All events, with those that belong to no run.
    pub all: u64,
    /// Those of runs, of at most [`MOST_COUNTED_RUNS`].
    pub runs: BTreeMap<RunId, u64>,
}

/// Events that were handed in to this process, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HandedIn {
    /// In a batch.
    pub taken: RunCounts,
    /// Dropped.
    pub dropped: RunCounts,
    /// When the last of them came; `None` before the first.
    pub last: Option<WallTime>,
}

/// What a process counted at the moment at which each event was handed in: it outlives the process.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CountedEvents {
    /// All events.
    pub all: u64,
    /// When the last of them came.
    pub last: WallTime,
    /// The last batches that were sent without being in the spool.
    pub sent: Vec<SentUnspooled>,
    /// The runs under way.
    pub runs: Vec<CountedRun>,
}

/// What a spool says of the events that were handed in to the process which wrote it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settled {
    /// Those in a batch and those that were dropped.
    pub events: RunCounts,
    /// Those in a batch.
    pub taken: u64,
    /// When the last of them came.
    pub last: Option<WallTime>,
}

/// One run of [`CountedEvents`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CountedRun {
    /// The run.
    pub run: RunId,
    /// Its pipeline, where it is known.
    pub pipeline: Option<Slug>,
    /// Its events.
    pub events: u64,
    /// When the last of them came.
    pub last: WallTime,
}

impl RunCounts {
    /// Counts so many events more. A run that finds no place of its own counts among all.
    pub fn add(&mut self, run: Option<RunId>, events: u64) {
        self.all += events;
        let Some(run) = run else { return };
        if self.runs.len() < MOST_COUNTED_RUNS || self.runs.contains_key(&run) {
            *self.runs.entry(run).or_default() += events;
        }
    }

    /// The events of a run.
    pub fn of(&self, run: RunId) -> u64 {
        self.runs.get(&run).copied().unwrap_or_default()
    }
}

impl HandedIn {
    /// What the spool is to say of them.
    pub fn settled(&self) -> Settled {
        let mut events = self.taken.clone();
        events.all += self.dropped.all;
        for (run, count) in &self.dropped.runs {
            *events.runs.entry(*run).or_default() += count;
        }
        Settled { events, taken: self.taken.all, last: self.last }
    }

    /// What was taken and is not in `kept` counts as dropped.
    pub(super) fn give_up(&mut self, kept: &RunCounts) {
        let taken = std::mem::replace(&mut self.taken, kept.clone());
        self.dropped.all += taken.all.saturating_sub(kept.all);
        for (run, events) in taken.runs {
            *self.dropped.runs.entry(run).or_default() += events.saturating_sub(kept.of(run));
        }
    }

    pub(super) fn forget(&mut self, run: RunId) {
        self.taken.runs.remove(&run);
        self.dropped.runs.remove(&run);
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

impl CountedEvents {
    /// The gaps of `lost` events. Of those that the spool does not have, so many were stored or told of all the same, nobody
    /// knows of which runs.
    pub(super) fn gaps(&self, settled: &Settled, known: u64, lost: u64) -> Vec<Gap> {
        let mut left = lost;
        let gap = |pipeline, run, count, to: WallTime| {
            let from = settled.last.unwrap_or(to).min(to);
            Gap { pipeline, run, from, to, count, reason: KILLED.to_owned() }
        };
        let mut gaps = Vec::new();
        for CountedRun { run, pipeline, events, last } in &self.runs {
            let count = events.saturating_sub(settled.events.of(*run)).saturating_sub(known).min(left);
            left -= count;
            gaps.push(gap(pipeline.clone(), Some(*run), count, *last));
        }
        gaps.push(gap(None, None, left, self.last));
        gaps.retain(|gap| gap.count > 0);
        gaps
    }
}

impl Event {
    /// The run that it belongs to.
    pub const fn run(&self) -> Option<RunId> {
        match self {
            Self::RunStarted(started) => Some(started.run),
            Self::RunEnded(ended) => Some(ended.run),
            Self::Iteration(iteration) => Some(iteration.run),
            Self::Incident(incident) => incident.run,
            Self::Gap(gap) => gap.run,
            Self::Clock(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StreamId;

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
