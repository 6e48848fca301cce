//! Events that are handed in, counted by run: what a process that was killed took with it is known by them.

use std::collections::BTreeMap;

use peernet_clock::WallTime;

use super::spool::SpoolState;
use super::{Event, Gap};
use crate::{RunId, Slug};

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
    /// What was sent without being in the spool.
    pub sent: SentUnspooled,
    /// The runs under way.
    pub runs: Vec<CountedRun>,
}

/// How far batches were sent that the spool could not take: they may be stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SentUnspooled {
    /// Events that were settled with the newest of them.
    pub events: u64,
    /// Dropped events that gaps had reported by then, as [`super::Totals::told`].
    pub told: u64,
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
    /// Events that are in a batch or were dropped.
    pub fn settled(&self) -> RunCounts {
        let mut counts = self.taken.clone();
        counts.all += self.dropped.all;
        for (run, events) in &self.dropped.runs {
            *counts.runs.entry(*run).or_default() += events;
        }
        counts
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
    /// `settled`, the last of them at `since`: what is missing was lost with that process. Returns how many events that
    /// are.
    ///
    /// What was sent without being in the spool counts as stored, so that no gap is reported for what is there. The number
    /// is exact otherwise; a run that was not counted separately leaves its losses to a gap that names no run.
    pub fn lose_tail(
        &mut self,
        counted: &CountedEvents,
        settled: &RunCounts,
        since: Option<WallTime>,
    ) -> u64 {
        let known = settled.all.max(counted.sent.events);
        let lost = counted.all.saturating_sub(known);
        self.skip_told(counted.sent.told);
        let mut left = lost;
        for CountedRun { run, pipeline, events, last } in &counted.runs {
            let count = events.saturating_sub(settled.of(*run)).min(left);
            left -= count;
            self.lose(pipeline.clone(), Some(*run), count, (since, *last));
        }
        self.lose(None, None, left, (since, counted.last));
        self.totals.produced += lost + (known - settled.all);
        self.totals.dropped += lost;
        lost
    }

    /// So many dropped events may be reported already.
    fn skip_told(&mut self, told: u64) {
        let told = told.min(self.totals.dropped);
        while let Some(gap) = self.unreported.first()
            && self.totals.told.saturating_add(gap.count) <= told
        {
            self.totals.told += gap.count;
            self.unreported.remove(0);
        }
        if self.unreported.is_empty() {
            self.totals.told = self.totals.told.max(told);
        }
    }

    fn lose(
        &mut self,
        pipeline: Option<Slug>,
        run: Option<RunId>,
        count: u64,
        (since, to): (Option<WallTime>, WallTime),
    ) {
        if count == 0 {
            return;
        }
        let from = since.unwrap_or(to).min(to);
        let same = |gap: &&mut Gap| (&gap.pipeline, gap.run) == (&pipeline, run) && gap.reason == KILLED;
        let full = self.unreported.len() >= MOST_UNREPORTED;
        let merge = |gap: &mut Gap| {
            (gap.count, gap.from, gap.to) = (gap.count + count, gap.from.min(from), gap.to.max(to));
        };
        if let Some(gap) = self.unreported.iter_mut().find(same) {
            return merge(gap);
        }
        match self.unreported.last_mut().filter(|_| full) {
            Some(gap) => {
                (gap.pipeline, gap.run) = (None, None);
                merge(gap);
            }
            None => {
                let reason = KILLED.to_owned();
                self.unreported.push(Gap { pipeline, run, from, to, count, reason });
            }
        }
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
    use crate::stream::StreamId;

    fn at(seconds: i64) -> WallTime {
        WallTime::from_unix_nanos(seconds * 1_000_000_000)
    }

    fn counted(all: u64, runs: &[(RunId, u64)]) -> CountedEvents {
        let run = |&(run, events)| CountedRun { run, pipeline: "line".parse().ok(), events, last: at(9) };
        CountedEvents {
            all,
            last: at(10),
            sent: SentUnspooled::default(),
            runs: runs.iter().map(run).collect(),
        }
    }

    #[test]
    fn lost_tail_is_split_by_run() {
        let (first, second, ended) = (RunId::random(), RunId::random(), RunId::random());
        let mut state = SpoolState::new(StreamId::random());
        state.totals.produced = 100;
        let settled = RunCounts { all: 100, runs: BTreeMap::from([(first, 60), (ended, 30)]) };
        let counted = counted(115, &[(first, 70), (second, 4)]);
        assert_eq!(state.lose_tail(&counted, &settled, Some(at(8))), 15);
        assert_eq!((state.totals.produced, state.totals.dropped, state.totals.told), (115, 15, 0));
        let gaps: Vec<_> =
            state.unreported.iter().map(|gap| (gap.run, gap.count, gap.from, gap.to)).collect();
        let expected =
            [(Some(first), 10, at(8), at(9)), (Some(second), 4, at(8), at(9)), (None, 1, at(8), at(10))];
        assert_eq!(gaps, expected);
        // Another process that is killed at once changes only how many they are.
        assert_eq!(state.lose_tail(&CountedEvents { all: 2, ..counted }, &RunCounts::default(), None), 2);
        assert_eq!((state.unreported.len(), state.unreported[0].count), (3, 12));
    }

    #[test]
    fn nothing_is_lost_when_everything_is_settled() {
        let (run, mut state) = (RunId::random(), SpoolState::new(StreamId::random()));
        let settled = RunCounts { all: 7, runs: BTreeMap::from([(run, 5)]) };
        assert_eq!(state.lose_tail(&counted(7, &[(run, 5)]), &settled, None), 0);
        // A counter that is behind the spool proves nothing.
        assert_eq!(state.lose_tail(&counted(3, &[(run, 6)]), &settled, None), 0);
        assert_eq!(state, SpoolState::new(state.stream));
    }

    #[test]
    fn many_losses_of_earlier_processes_stay_few_gaps() {
        let mut state = SpoolState::new(StreamId::random());
        for _ in 0..500 {
            let run = RunId::random();
            state.lose_tail(&counted(3, &[(run, 3)]), &RunCounts::default(), None);
        }
        assert_eq!(state.unreported.len(), MOST_UNREPORTED);
        assert_eq!(state.unreported.iter().map(|gap| gap.count).sum::<u64>(), 1_500);
    }
}
