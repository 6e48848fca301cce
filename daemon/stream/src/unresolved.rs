//! Batches that a process sent while its spool could not be written, before the process was killed. The aggregator's
//! first welcome states whether they are stored.
//!
//! Without this statement, the events of these batches would be reported as lost although they may be stored.

use std::collections::VecDeque;

use crate::counts::{CountedEvents, SentUnspooled, SettledEvents};
use crate::totals::Totals;
use crate::{Gap, MAX_IN_FLIGHT_BATCHES};

/// Number of batches for which [`SentUnspooled`] must be kept: the batches that may be in flight, and the last
/// acknowledged batch.
pub const MAX_SENT_UNSPOOLED: usize = MAX_IN_FLIGHT_BATCHES + 1;

/// The last batches of a process, some of which may be stored although its spool does not contain them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnresolvedBatches {
    /// Events that were submitted to the process, as counted in shared memory.
    pub counted: CountedEvents,
    /// Those of these events that the spool has in batches, or has counted as dropped.
    pub settled: SettledEvents,
    /// Number of dropped events that gaps in the spool have reported ([`super::Totals::reported_drops`]).
    pub reported_drops: u64,
    /// Number of events in all batches that were written to the spool since it was created, including gaps.
    pub spooled_events: u64,
}

/// Numbers of events of an earlier process, after a welcome has stated which of its batches are stored. The numbers are
/// added to the [`Totals`] of the spool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ResolvedBatches {
    /// Number of events in batches that are stored and were never written to the spool.
    pub(super) stored: u64,
    /// Number of lost events.
    pub(super) lost: u64,
    /// Number of dropped events that stored gaps report, but that the spool's totals do not count as reported yet.
    pub(super) reported_drops: u64,
    /// Number of submitted events in the batches of `stored`. The other events of these batches are gaps, which the
    /// stream itself adds.
    stored_submitted: u64,
}

impl CountedEvents {
    /// Returns whether batches were sent that are not in the spool. The aggregator may have stored these batches.
    pub(super) fn may_be_stored(&self, settled: &SettledEvents, totals: &Totals) -> bool {
        self.sent
            .iter()
            .any(|sent| sent.batched > settled.batched || sent.reported_drops > totals.reported_drops)
    }
}

impl UnresolvedBatches {
    pub(super) fn new(counted: CountedEvents, settled: SettledEvents, totals: &Totals) -> Self {
        let spooled_events = totals.produced.saturating_sub(totals.dropped);
        Self { counted, settled, reported_drops: totals.reported_drops, spooled_events }
    }

    /// Returns which events are stored and which are lost, if the aggregator has stored all batches up to batch
    /// `number` and `process` sent this batch.
    pub(super) fn resolve(&self, number: u64, process: Option<u64>) -> ResolvedBatches {
        let is_last_stored = |sent: &&SentUnspooled| Some(sent.process) == process && sent.number == number;
        // If another process or a copy of the spool sent the last stored batch, none of these batches counts as
        // stored.
        let sent = self.counted.sent.iter().find(is_last_stored).copied().unwrap_or_default();
        let stored_submitted = sent.batched.saturating_sub(self.settled.batched);
        ResolvedBatches {
            stored: sent.events.saturating_sub(self.spooled_events),
            lost: self.counted.total.saturating_sub(self.settled.events.total + stored_submitted),
            reported_drops: sent.reported_drops.saturating_sub(self.reported_drops),
            stored_submitted,
        }
    }

    /// Updates the losses that must still be reported. `earlier_gaps` are gaps that are not sent yet. `earlier_drops`
    /// is the number of events that earlier processes dropped and that are in no gap. Removes, the oldest first, the
    /// losses that stored gaps of the killed process have reported. Adds gaps for the other losses of the killed
    /// process.
    pub(super) fn update_unreported(
        &self,
        resolved: &ResolvedBatches,
        earlier_gaps: &mut VecDeque<Gap>,
        earlier_drops: &mut u64,
    ) {
        // A stored gap states how many losses it reports, but not which. Losses are reported in the order in which they
        // happened, so the oldest losses are those that were reported.
        let mut reported_drops = resolved.reported_drops;
        while let Some(gap) = earlier_gaps.pop_front_if(|gap| gap.count <= reported_drops) {
            reported_drops -= gap.count;
        }
        // The killed process reported its losses in this order: the gaps above, the drops that the spool's totals count
        // (`earlier_drops`), and the drops that were not written to the spool (a part of `resolved.lost`).
        let reported_earlier_drops = reported_drops.min(*earlier_drops);
        *earlier_drops -= reported_earlier_drops;
        reported_drops -= reported_earlier_drops;
        let reported_lost = reported_drops.min(resolved.lost);
        reported_drops -= reported_lost;
        // A gap in `earlier_gaps` may be merged: it then contains reported losses together with losses of a process
        // that was started after the killed process.
        while let Some(mut gap) = (reported_drops > 0).then(|| earlier_gaps.pop_front()).flatten() {
            let reported_in_gap = reported_drops.min(gap.count);
            reported_drops -= reported_in_gap;
            gap.count -= reported_in_gap;
            if gap.count > 0 {
                earlier_gaps.push_front(gap);
            }
        }
        earlier_gaps.extend(self.counted.gaps(
            &self.settled,
            resolved.stored_submitted + reported_lost,
            resolved.lost - reported_lost,
        ));
    }
}

impl Totals {
    /// Returns the totals plus the numbers of the earlier process.
    pub(super) fn with_resolved(self, resolved: &ResolvedBatches) -> Self {
        Self {
            produced: self.produced + resolved.stored + resolved.lost,
            dropped: self.dropped + resolved.lost,
            reported_drops: self.reported_drops + resolved.reported_drops,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::WallTime;

    use super::*;
    use crate::{CountedRun, KILLED_REASON, RunCounts, SpoolState, StreamId};
    use peernet_logger::RunId;

    const PROCESS: u64 = 7;

    /// Returns a spool with the batches up to 3, which has 10 of 30 events in batches or as dropped. Two further
    /// batches were sent: batch 4 with 6 events, and batch 5 with 3 events and a gap of 2 events.
    fn unresolved(run: RunId) -> (SpoolState, UnresolvedBatches) {
        let mut state = SpoolState::new(StreamId::random());
        (state.totals.produced, state.totals.dropped, state.totals.reported_drops) = (15, 3, 1);
        let sent = |number, batched, reported_drops, events| SentUnspooled {
            process: PROCESS,
            number,
            batched,
            reported_drops,
            events,
        };
        let last = WallTime::from_unix_nanos(9);
        let runs = vec![CountedRun { run, pipeline: None, events: 26, last }];
        let sent = vec![sent(4, 14, 1, 18), sent(5, 17, 3, 22)];
        let counted = CountedEvents { total: 30, last, sent, runs };
        let events = RunCounts { total: 10, runs: [(run, 9)].into() };
        assert_eq!(
            state.record_losses_of_killed_process(counted, SettledEvents { events, batched: 8, last: None }),
            None
        );
        let unresolved = state.unresolved.clone().expect("the sent batches may be stored");
        (state, unresolved)
    }

    /// Returns the number of unreported losses with a known run, and without a known run.
    fn unreported_losses(
        unresolved: &UnresolvedBatches,
        resolved: &ResolvedBatches,
        mut earlier_drops: u64,
    ) -> (u64, u64) {
        let mut earlier_gaps = VecDeque::new();
        unresolved.update_unreported(resolved, &mut earlier_gaps, &mut earlier_drops);
        assert!(earlier_gaps.iter().all(|gap| gap.reason == KILLED_REASON));
        let (with_run, without_run): (Vec<_>, Vec<_>) =
            earlier_gaps.iter().partition(|gap| gap.run.is_some());
        let sum = |gaps: Vec<&Gap>| gaps.iter().map(|gap| gap.count).sum();
        (sum(with_run), earlier_drops + sum(without_run))
    }

    #[test]
    fn last_stored_batch_determines_lost_events() {
        let (state, unresolved) = unresolved(RunId::random());
        // Of the 3 dropped events, 2 are not reported. 20 events were submitted and neither stored nor dropped.
        let none_stored = unresolved.resolve(3, Some(PROCESS));
        assert_eq!((none_stored.stored, none_stored.lost, none_stored.reported_drops), (0, 20, 0));
        assert_eq!(unreported_losses(&unresolved, &none_stored, 2), (17, 2 + 3));
        assert_eq!(
            unresolved.resolve(5, Some(PROCESS + 1)),
            none_stored,
            "a batch 5 of another process proves nothing"
        );

        let one_stored = unresolved.resolve(4, Some(PROCESS));
        assert_eq!((one_stored.stored, one_stored.lost, one_stored.reported_drops), (6, 14, 0));
        let (with_run, without_run) = unreported_losses(&unresolved, &one_stored, 2);
        assert_eq!(
            (with_run, with_run + without_run),
            (11, 2 + 14),
            "the 6 stored events may all be of the run, so 6 of its 17 losses are reported without a run"
        );

        let both_stored = unresolved.resolve(5, Some(PROCESS));
        assert_eq!((both_stored.stored, both_stored.lost, both_stored.reported_drops), (10, 11, 2));
        let (with_run, without_run) = unreported_losses(&unresolved, &both_stored, 2);
        assert_eq!(with_run + without_run, 11, "the gap in batch 5 reported the 2 unreported drops");
        let totals = state.totals.with_resolved(&both_stored);
        assert_eq!((totals.produced, totals.dropped, totals.reported_drops), (36, 14, 3));
    }

    #[test]
    fn losses_in_stored_gap_are_not_reported_again() {
        let (_, unresolved) = unresolved(RunId::random());
        let gap = |count| Gap {
            pipeline: None,
            run: None,
            from: WallTime::from_unix_nanos(1),
            to: WallTime::from_unix_nanos(1),
            count,
            reason: "full".to_owned(),
        };
        let (mut earlier_gaps, mut earlier_drops) = (VecDeque::from([gap(1), gap(4)]), 0);
        unresolved.update_unreported(
            &unresolved.resolve(5, Some(PROCESS)),
            &mut earlier_gaps,
            &mut earlier_drops,
        );
        assert_eq!(earlier_gaps.front().map(|gap| gap.count), Some(4));
        assert_eq!(earlier_gaps.iter().map(|gap| gap.count).sum::<u64>(), 5 + 11 - 2);
    }

    #[test]
    fn reported_part_of_merged_gap_is_not_reported_again() {
        let (_, unresolved) = unresolved(RunId::random());
        let resolved = ResolvedBatches { lost: 1, reported_drops: 4, ..ResolvedBatches::default() };
        // A gap for events that were lost when a process was killed.
        let gap =
            |count| Gap { count, ..unresolved.counted.gaps(&SettledEvents::default(), 0, 1)[0].clone() };
        let (mut earlier_gaps, mut earlier_drops) = (VecDeque::from([gap(5)]), 1);
        unresolved.update_unreported(&resolved, &mut earlier_gaps, &mut earlier_drops);
        let counts: Vec<u64> = earlier_gaps.iter().map(|gap| gap.count).collect();
        assert_eq!(
            (counts, earlier_drops),
            (vec![3], 0),
            "of 7 losses (5 in the gap, 1 drop, 1 lost event), 4 were reported"
        );
    }

    #[test]
    fn batches_stay_unresolved_if_next_process_is_killed_before_answer() {
        let run = RunId::random();
        let (mut state, first) = unresolved(run);
        let counted = CountedEvents { total: 2, ..first.counted.clone() };
        let nothing_sent = CountedEvents { sent: Vec::new(), runs: Vec::new(), ..counted };
        assert_eq!(state.record_losses_of_killed_process(nothing_sent, SettledEvents::default()), Some(2));
        assert_eq!(state.unresolved, Some(first));
        assert_eq!((state.totals.dropped, state.unreported.len()), (5, 1));
    }
}
