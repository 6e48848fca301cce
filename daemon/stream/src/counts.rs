//! Events that are handed in, counted by run: what a process that was killed took with it is known by them.

use std::collections::BTreeMap;

use peernet_clock::WallTime;
use peernet_logger::{RunId, Slug};

use crate::Gap;

/// Runs that are counted separately, at most: one a pipeline, and some that have just ended.
pub const MOST_COUNTED_RUNS: usize = 256;

/// Reason of the gap that takes the place of the events which were lost with their process.
pub const KILLED: &str = "the agent was killed before these events reached its spool";

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

/// A batch that was sent and is not in the spool. All numbers count up to its last event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SentUnspooled {
    /// The process that sent it ([`super::Hello::process`]).
    pub process: u64,
    /// Its number.
    pub number: u64,
    /// Events that were handed in to that process and are in batches.
    pub taken: u64,
    /// Dropped events that gaps have reported, as [`super::Totals::told`].
    pub told: u64,
    /// Events in batches since the spool was made, with the gaps.
    pub events: u64,
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
