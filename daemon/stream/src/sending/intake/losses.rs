//! Dropped events that have not been reported yet.

use peernet_clock::{MonoTime, Span, Stamp};

use crate::Gap;
use peernet_logger::{RunId, Slug};

/// Maximum number of losses that are counted separately. Further losses are counted together; an agent has few
/// pipelines and few reasons.
const MAX_LOSSES: usize = 64;

/// Interval between the reports of a continuing loss. The loss is also reported at its end. Losses between two reports
/// form one gap.
const REPORT_INTERVAL: Span = Span::from_seconds(1);

/// Dropped events by pipeline, run and reason.
#[derive(Clone, Debug, Default)]
pub(super) struct Losses {
    entries: Vec<Loss>,
}

/// A loss that may continue.
#[derive(Clone, Debug)]
struct Loss {
    /// Gap that is not reported yet; its count is 0 if everything is reported.
    gap: Gap,
    /// Time of the last report; `None` before the first report.
    reported_at: Option<MonoTime>,
}

impl Losses {
    /// Counts `count` events that are dropped now.
    pub(super) fn add(
        &mut self,
        pipeline: Option<Slug>,
        run: Option<RunId>,
        now: Stamp,
        count: u64,
        reason: String,
    ) {
        let has_same_cause = |loss: &&mut Loss| {
            let gap = &loss.gap;
            gap.pipeline == pipeline && gap.run == run && gap.reason == reason
        };
        if let Some(loss) = self.entries.iter_mut().find(has_same_cause) {
            loss.extend(now, count);
            return;
        }
        if self.entries.len() >= MAX_LOSSES {
            // Losses that are completely reported are removed first.
            self.entries.retain(|loss| loss.gap.count > 0);
        }
        if self.entries.len() < MAX_LOSSES {
            let gap = Gap { pipeline, run, from: now.wall, to: now.wall, count, reason };
            self.entries.push(Loss { gap, reported_at: None });
        } else {
            // The number of events stays exact; only their pipeline, run and reason become unknown.
            let loss = &mut self.entries[MAX_LOSSES - 1];
            (loss.gap.pipeline, loss.gap.run, loss.gap.reason) =
                (None, None, "several reasons, too many to list".into());
            loss.extend(now, count);
        }
    }

    /// Counts the events of `gap`. Another component dropped these events and reported no gap.
    pub(super) fn add_gap(&mut self, gap: Gap, now: Stamp) {
        let Gap { pipeline, run, from, to, count, reason } = gap;
        self.add(pipeline.clone(), run, now, count, reason.clone());
        let has_same_cause = |loss: &&mut Loss| {
            let gap = &loss.gap;
            gap.pipeline == pipeline && gap.run == run && gap.reason == reason
        };
        if let Some(loss) = self.entries.iter_mut().find(has_same_cause) {
            (loss.gap.from, loss.gap.to) = (loss.gap.from.min(from), loss.gap.to.max(to));
        }
    }

    /// Returns the number of gaps to be reported, now or later.
    pub(super) fn len(&self) -> usize {
        self.entries.iter().filter(|loss| loss.gap.count > 0).count()
    }

    /// Returns the time of the next report. A loss without a recent report is due at once.
    pub(super) fn next_report_at(&self) -> Option<MonoTime> {
        let unreported = self.entries.iter().filter(|loss| loss.gap.count > 0);
        unreported.map(|loss| loss.reported_at.map_or(MonoTime::default(), |at| at + REPORT_INTERVAL)).min()
    }

    /// Returns the next due gap, and records it as reported.
    pub(super) fn take_due(&mut self, now: MonoTime) -> Option<Gap> {
        // A reported loss is kept for one interval. Otherwise the next drop with the same cause would be reported at
        // once.
        self.entries.retain(|loss| loss.gap.count > 0 || !loss.is_due(now));
        let due = self.entries.iter_mut().find(|loss| loss.gap.count > 0 && loss.is_due(now));
        due.map(|loss| loss.take_gap(now))
    }

    /// Returns the next gap of the losses that end now: the losses of `run`, or all losses if `run` is `None`. Records
    /// the gap as reported.
    pub(super) fn take_ended(&mut self, run: Option<RunId>, now: MonoTime) -> Option<Gap> {
        let is_ended = |loss: &&mut Loss| loss.gap.count > 0 && (run.is_none() || loss.gap.run == run);
        self.entries.iter_mut().find(is_ended).map(|loss| loss.take_gap(now))
    }
}

impl Loss {
    fn extend(&mut self, now: Stamp, count: u64) {
        if self.gap.count == 0 {
            (self.gap.from, self.gap.to) = (now.wall, now.wall);
        }
        // The wall clock may have been set back since the first drop.
        (self.gap.from, self.gap.to) = (self.gap.from.min(now.wall), self.gap.to.max(now.wall));
        self.gap.count += count;
    }

    fn is_due(&self, now: MonoTime) -> bool {
        self.reported_at.is_none_or(|at| now - at >= REPORT_INTERVAL)
    }

    fn take_gap(&mut self, now: MonoTime) -> Gap {
        self.reported_at = Some(now);
        // The entry remains, so that a loss that continues is reported once per interval.
        let remaining_gap = Gap { count: 0, ..self.gap.clone() };
        std::mem::replace(&mut self.gap, remaining_gap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Stamp {
        Stamp::default() + Span::from_millis(millis)
    }

    #[test]
    fn losses_are_separated_by_run_up_to_limit_and_all_counted() {
        let mut losses = Losses::default();
        for n in 0..200 {
            losses.add(None, Some(RunId::random()), at(n), 2, "full".into());
        }
        assert_eq!(losses.len(), MAX_LOSSES);
        let gaps: Vec<_> = std::iter::from_fn(|| losses.take_due(at(200).mono)).collect();
        assert_eq!(gaps.iter().map(|gap| gap.count).sum::<u64>(), 400);
        assert_eq!(gaps[MAX_LOSSES - 1].to, at(199).wall);
        assert_eq!((losses.len(), losses.next_report_at()), (0, None));
        // Reported losses free capacity for other losses.
        losses.add(None, None, at(300), 1, "another".into());
        assert_eq!(losses.take_ended(None, at(300).mono).expect("a gap").reason, "another");
    }

    #[test]
    fn gap_ends_after_its_start_although_clock_is_set_back() {
        let mut losses = Losses::default();
        let after_step = Stamp { wall: at(200).wall, ..at(5_000) };
        for now in [at(4_000), after_step] {
            losses.add(None, None, now, 1, "full".into());
        }
        let gap = losses.take_due(after_step.mono).expect("a gap");
        assert_eq!((gap.from, gap.to, gap.count), (at(200).wall, at(4_000).wall, 2));
    }

    #[test]
    fn continuing_loss_is_one_gap_per_second() {
        let (mut losses, run) = (Losses::default(), Some(RunId::random()));
        let mut gaps = Vec::new();
        // One of two events is dropped for three seconds.
        for n in 0..1_500 {
            losses.add(None, run, at(2 * n), 1, "full".into());
            gaps.extend(losses.take_due(at(2 * n + 1).mono));
        }
        assert_eq!(losses.next_report_at(), Some(at(3_001).mono));
        assert!(losses.take_ended(Some(RunId::random()), at(3_000).mono).is_none());
        gaps.extend(losses.take_ended(run, at(3_000).mono));
        assert_eq!(gaps.iter().map(|gap| gap.count).collect::<Vec<_>>(), [1, 500, 500, 499]);
        assert!(gaps.windows(2).all(|pair| pair[0].to < pair[1].from));
        assert_eq!(losses.len(), 0);
    }
}
