//! Counts of the events that were submitted to the event stream, per run. The counts show which events a killed process
//! lost.

use std::collections::BTreeMap;

use peernet_clock::WallTime;
use peernet_logger::{RunId, Slug};

use crate::Gap;

/// Maximum number of runs that are counted separately: one per pipeline, and some that have just ended.
pub const MAX_COUNTED_RUNS: usize = 256;

/// Reason of the gap in place of events that were lost with their process.
pub const KILLED_REASON: &str = "the agent was killed before these events reached its spool";

/// Numbers of events in total and per run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunCounts {
    /// Number of all events, including events without a run.
    pub total: u64,
    /// Number of events of each run, for at most [`MAX_COUNTED_RUNS`] runs.
    pub runs: BTreeMap<RunId, u64>,
}

/// Events that were submitted to this process, by outcome.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SubmittedEvents {
    /// Events in batches.
    pub batched: RunCounts,
    /// Dropped events.
    pub dropped: RunCounts,
    /// Time of the last event; `None` before the first.
    pub last: Option<WallTime>,
}

/// Numbers of events that were submitted to a process, counted at the time of submission. The counts are in shared
/// memory, which outlives the process.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CountedEvents {
    /// Number of all events.
    pub total: u64,
    /// Time of the last event.
    pub last: WallTime,
    /// The last batches that were sent without being in the spool.
    pub sent: Vec<SentUnspooled>,
    /// Counts of the active runs.
    pub runs: Vec<CountedRun>,
}

/// Events of a process that its spool has in batches or has counted as dropped.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SettledEvents {
    /// Events in batches, and dropped events.
    pub events: RunCounts,
    /// Number of events in batches.
    pub batched: u64,
    /// Time of the last event.
    pub last: Option<WallTime>,
}

/// A batch that was sent, or is about to be sent, although it is not in the spool. All counts include this batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SentUnspooled {
    /// Process that sent the batch ([`super::Hello::process`]).
    pub process: u64,
    /// Number of the batch.
    pub number: u64,
    /// Number of events that were submitted to that process and are in batches.
    pub batched: u64,
    /// Number of dropped events that gaps have reported, like [`super::Totals::reported_drops`].
    pub reported_drops: u64,
    /// Number of events in all batches since the spool was created, including gaps.
    pub events: u64,
}

/// Count of one run of [`CountedEvents`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CountedRun {
    /// Id of the run.
    pub run: RunId,
    /// Pipeline of the run, if known.
    pub pipeline: Option<Slug>,
    /// Number of events.
    pub events: u64,
    /// Time of the last event.
    pub last: WallTime,
}

impl RunCounts {
    /// Adds events. If there are too many runs for a separate count of `run`, the events are added to the total only.
    pub fn add(&mut self, run: Option<RunId>, events: u64) {
        self.total += events;
        let Some(run) = run else { return };
        if self.runs.len() < MAX_COUNTED_RUNS || self.runs.contains_key(&run) {
            *self.runs.entry(run).or_default() += events;
        }
    }

    /// Returns the number of events of a run.
    pub fn events_of(&self, run: RunId) -> u64 {
        self.runs.get(&run).copied().unwrap_or_default()
    }
}

impl SubmittedEvents {
    /// Returns these events as events that are in batches of the spool or counted as dropped.
    pub fn settled(&self) -> SettledEvents {
        let mut events = self.batched.clone();
        events.total += self.dropped.total;
        for (run, count) in &self.dropped.runs {
            *events.runs.entry(*run).or_default() += count;
        }
        SettledEvents { events, batched: self.batched.total, last: self.last }
    }

    /// Counts batched events as dropped, except the events that `retained` counts: these events are in the spool, or the
    /// aggregator has stored them.
    pub(super) fn give_up(&mut self, retained: &RunCounts) {
        let batched = std::mem::replace(&mut self.batched, retained.clone());
        self.dropped.total += batched.total.saturating_sub(retained.total);
        for (run, events) in batched.runs {
            *self.dropped.runs.entry(run).or_default() += events.saturating_sub(retained.events_of(run));
        }
    }

    /// Removes the separate counts of a run; its events stay in the totals.
    pub(super) fn forget(&mut self, run: RunId) {
        self.batched.runs.remove(&run);
        self.dropped.runs.remove(&run);
    }
}

impl CountedEvents {
    /// Returns the gaps for `lost` events.
    ///
    /// `accounted` is the number of events that are not in the spool and yet need no gap: the aggregator has stored
    /// these events, or a gap has reported them as lost. The runs of these events are unknown.
    pub(super) fn gaps(&self, settled: &SettledEvents, accounted: u64, lost: u64) -> Vec<Gap> {
        let mut unassigned = lost;
        let gap = |pipeline, run, count, to: WallTime| {
            // The lost events are newer than the events that the spool has in batches or has counted as dropped.
            let from = settled.last.unwrap_or(to).min(to);
            Gap { pipeline, run, from, to, count, reason: KILLED_REASON.to_owned() }
        };
        let mut gaps = Vec::new();
        for CountedRun { run, pipeline, events, last } in &self.runs {
            let count = events
                .saturating_sub(settled.events.events_of(*run))
                // The accounted events may all be of this run, because their runs are unknown. If some of them are of
                // other runs, this count is too low, and the other lost events are reported without a run.
                .saturating_sub(accounted)
                .min(unassigned);
            unassigned -= count;
            gaps.push(gap(pipeline.clone(), Some(*run), count, *last));
        }
        // Events without a run, and events of runs that are not counted separately.
        gaps.push(gap(None, None, unassigned, self.last));
        gaps.retain(|gap| gap.count > 0);
        gaps
    }
}
