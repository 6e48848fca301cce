//! The latest seconds of one pipeline.

use std::collections::VecDeque;

use peernet_logger::Tree;
use peernet_stream::{Outcome, Second};

use super::second_statistics::SecondStatistics;

/// Largest number of seconds in the ring.
const MAX_SECONDS: usize = 64;
/// Largest number of seconds in one update. After an outage the newest seconds are sent first.
const MAX_SENT_SECONDS: usize = 8;
/// Largest number of seconds between the newest second and an earlier second in which an iteration ends. Iterations are
/// recorded when they end, so a larger number means that the wall clock was set back.
const MAX_BACKWARD_S: i64 = 1;

/// Statistics of the seconds in which an iteration ended, oldest first.
#[derive(Debug, Default)]
pub(super) struct Ring {
    seconds: VecDeque<SecondStatistics>,
    version: u64,
}

/// Seconds of a ring that are in an update: (second, version).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct SentSeconds(Vec<(i64, u64)>);

impl Ring {
    /// Adds an iteration that ended within the second `at` (Unix time).
    pub(super) fn record(&mut self, at: i64, outcome: &Outcome, tree: &Tree) {
        // The version orders changes and updates: a second that changes while an update is sent is sent again.
        self.version += 1;
        let version = self.version;
        let second = self.second_at(at);
        second.version = version;
        second.record(outcome, tree);
    }

    fn second_at(&mut self, at: i64) -> &mut SecondStatistics {
        if self.seconds.back().is_some_and(|newest| at < newest.at - MAX_BACKWARD_S) {
            // Seconds that occur again after the clock was set back replace the earlier seconds.
            self.seconds.retain(|second| second.at < at);
        }
        // The search starts at the end, because almost every iteration ends in the newest second.
        let last_not_later = self.seconds.iter().rposition(|second| second.at <= at);
        let index = match last_not_later {
            Some(index) if self.seconds[index].at == at => index,
            not_later => {
                let mut index = not_later.map_or(0, |index| index + 1);
                self.seconds.insert(index, SecondStatistics::new(at));
                // The new second itself stays, because the caller writes to it.
                if self.seconds.len() > MAX_SECONDS && index > 0 {
                    self.seconds.pop_front();
                    index -= 1;
                }
                index
            }
        };
        &mut self.seconds[index]
    }

    /// Returns the seconds that changed since they were last sent, newest first.
    pub(super) fn changed_seconds(&self) -> (Vec<Second>, SentSeconds) {
        let changed_seconds = self
            .seconds
            .iter()
            .rev()
            .filter(|second| second.version > second.sent_version)
            .take(MAX_SENT_SECONDS);
        let (seconds, sent) =
            changed_seconds.map(|second| (second.second(), (second.at, second.version))).unzip();
        (seconds, SentSeconds(sent))
    }

    /// Marks the seconds of an update as sent.
    pub(super) fn mark_sent(&mut self, sent: &SentSeconds) {
        for (at, version) in &sent.0 {
            // A second that changed after the update was made has a larger version and is sent again.
            if let Some(second) = self.seconds.iter_mut().find(|second| second.at == *at) {
                second.sent_version = *version;
            }
        }
    }

    /// Marks all seconds as not sent.
    pub(super) fn mark_all_unsent(&mut self) {
        for second in &mut self.seconds {
            // Versions begin at 1.
            second.sent_version = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, Interval, ManualClock, OneWayDelay, Span, Verdict, WallTime};
    use peernet_logger::{HostId, Measure, Recorder, stage};

    use super::*;

    fn tree(millis: i64) -> Tree {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
        let upload = log.start_transit(stage::UPLOAD, peernet_clock::Clock::stamp(&*clock));
        log.end_transit(upload, WallTime::from_unix_nanos(0) + Span::from_millis(millis));
        if let Some(Measure::Transit(transit)) = log.tree_mut().measure_mut(upload) {
            transit.delay = Some(OneWayDelay::same_clock(Span::from_millis(millis)));
        }
        log.finish()
    }

    #[test]
    fn sent_second_is_repeated_only_after_change() {
        let mut ring = Ring::default();
        ring.record(10, &Outcome::Ok, &tree(4));
        ring.record(11, &Outcome::Ok, &tree(6));
        ring.record(11, &Outcome::Timeout(String::new()), &tree(500));

        let (seconds, sent) = ring.changed_seconds();
        assert_eq!(seconds.iter().map(|second| second.at).collect::<Vec<_>>(), [11, 10]);
        assert_eq!((seconds[0].counts.ok, seconds[0].counts.timeout), (1, 1));
        let (name, upload) = &seconds[0].values[0];
        assert_eq!((name.as_str(), upload.count(), upload.moments.mean), ("upload", 1, 0.006));
        assert_eq!(seconds[0].bounds[0].1.moments.max, 0.0, "one clock: the bound is exact");
        assert_eq!(seconds[0].verdicts, [("upload".into(), "ok".into(), 1)]);

        assert_eq!(ring.changed_seconds().0.len(), 2, "not handed on: still to be shown");
        ring.record(11, &Outcome::Ok, &tree(8));
        ring.mark_sent(&sent);
        let (seconds, _) = ring.changed_seconds();
        assert_eq!((seconds.len(), seconds[0].at, seconds[0].counts.ok), (1, 11, 2));
    }

    #[test]
    fn second_without_answers_still_names_deadline() {
        let mut ring = Ring::default();
        let with_deadline = |missed: f64| {
            let mut tree = tree(4);
            let measure = Measure::Value(missed, peernet_logger::Unit::NONE);
            tree.add(peernet_logger::NodeId::ROOT, "deadline-missed".into(), Span::ZERO, measure);
            tree
        };
        ring.record(10, &Outcome::Ok, &with_deadline(0.0));
        ring.record(10, &Outcome::Ok, &with_deadline(1.0));
        ring.record(11, &Outcome::Timeout(String::new()), &with_deadline(1.0));
        ring.record(12, &Outcome::Timeout(String::new()), &tree(4));
        let deadline_summary = |second: &Second| {
            let summary = second.values.iter().find(|(name, _)| name == "deadline-missed");
            summary.map(|(_, summary)| (summary.count(), summary.moments.mean))
        };
        let (seconds, _) = ring.changed_seconds();
        assert_eq!(deadline_summary(&seconds[2]), Some((2, 0.5)));
        assert_eq!(deadline_summary(&seconds[1]).map(|(count, _)| count), Some(0));
        assert_eq!((seconds[1].values.len(), deadline_summary(&seconds[0])), (1, None));
    }

    #[test]
    fn starts_skipped_before_an_unanswered_iteration_count() {
        let mut ring = Ring::default();
        let mut late = tree(4);
        let measure = Measure::Value(5.0, peernet_logger::Unit::NONE);
        late.add(peernet_logger::NodeId::ROOT, "skipped-starts".into(), Span::ZERO, measure);
        ring.record(10, &Outcome::Timeout(String::new()), &late);
        let second = &ring.changed_seconds().0[0];
        assert_eq!(
            second.values.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
            ["skipped-starts"]
        );
        assert_eq!(second.values[0].1.moments.mean, 5.0);
    }

    #[test]
    fn stage_of_several_nodes_has_values_of_results() {
        let mut tree = tree(4);
        let root = peernet_logger::NodeId::ROOT;
        let timer = |millis| Measure::Timer(Some(Span::from_millis(millis)));
        let inference = tree.add(root, stage::INFERENCE, Span::ZERO, timer(40));
        let inner = tree.add(inference, "inner-model".into(), Span::ZERO, timer(10));
        for name in [stage::PREPROCESSING, stage::INFERENCE] {
            tree.add(inner, name, Span::ZERO, timer(5));
        }
        tree.add(root, stage::SEND_QUEUE, Span::ZERO, timer(1));
        tree.add(root, stage::SEND_QUEUE, Span::ZERO, timer(2));
        let mut ring = Ring::default();
        ring.record(10, &Outcome::Ok, &tree);
        let second = &ring.changed_seconds().0[0];
        let iteration = peernet_stream::Iteration {
            run: peernet_logger::RunId::random(),
            number: 1,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            tree,
        };
        let row = peernet_analysis::rows::Row::from_iteration(&iteration);
        for name in ["upload", "preprocessing", "inference", "send-queue"] {
            let summary = second.values.iter().find(|(other, _)| other == name).map(|(_, summary)| summary);
            let live = summary.map(|summary| (summary.count(), summary.moments.mean));
            assert_eq!(live, row.value(name).map(|seconds| (1, seconds)), "{name}");
        }
    }

    #[test]
    fn delays_without_value_are_counted_and_not_averaged() {
        let mut ring = Ring::default();
        ring.record(10, &Outcome::Ok, &tree(4));
        let mut inconsistent = tree(0);
        let upload = inconsistent.find(&["upload"]).expect("recorded").0;
        let delay = OneWayDelay {
            value: None,
            bounds: Some(Interval { lo: Span::ZERO, hi: Span::from_seconds(9) }),
            verdict: Verdict::Inconsistent,
            ..OneWayDelay::same_clock(Span::from_millis(3))
        };
        if let Some(Measure::Transit(transit)) = inconsistent.measure_mut(upload) {
            transit.delay = Some(delay);
        }
        ring.record(10, &Outcome::Ok, &inconsistent);
        ring.record(10, &Outcome::Ok, &tree(-1));

        let second = &ring.changed_seconds().0[0];
        assert_eq!(second.counts.ok, 3);
        assert_eq!((second.values[0].1.count(), second.values[0].1.moments.mean), (1, 0.004));
        assert_eq!((second.bounds[0].1.count(), second.bounds[0].1.moments.max), (1, 0.0));
        let verdicts = ["ok", "inconsistent", "stepped"].map(|verdict| ("upload".into(), verdict.into(), 1));
        assert_eq!(second.verdicts, verdicts);
    }

    #[test]
    fn updates_and_memory_are_bounded_without_reader() {
        let mut ring = Ring::default();
        for at in 0..1000 {
            ring.record(at, &Outcome::Ok, &tree(1));
        }
        assert_eq!(ring.seconds.len(), MAX_SECONDS);
        let mut sent_times = Vec::new();
        loop {
            let (seconds, sent) = ring.changed_seconds();
            if seconds.is_empty() {
                break;
            }
            assert!(seconds.len() <= MAX_SENT_SECONDS);
            sent_times.extend(seconds.iter().map(|second| second.at));
            ring.mark_sent(&sent);
        }
        assert!(
            sent_times.iter().copied().eq((1000 - MAX_SECONDS as i64..1000).rev()),
            "newest first: {sent_times:?}"
        );
    }

    #[test]
    fn repeated_seconds_of_wall_clock_are_not_summed() {
        let mut ring = Ring::default();
        for at in 4990..=5000 {
            ring.record(at, &Outcome::Ok, &tree(1));
        }
        ring.record(4999, &Outcome::Ok, &tree(1));
        assert_eq!(ring.seconds.len(), 11, "two that ended at nearly the same time");
        let counts_by_second = |ring: &Ring| {
            ring.seconds.iter().map(|second| (second.at, second.second().counts.ok)).collect::<Vec<_>>()
        };
        ring.record(4995, &Outcome::Ok, &tree(1));
        ring.record(4996, &Outcome::Ok, &tree(1));
        assert_eq!(counts_by_second(&ring), (4990..=4996).map(|at| (at, 1)).collect::<Vec<_>>());
        ring.record(1400, &Outcome::Ok, &tree(1));
        assert_eq!(counts_by_second(&ring), [(1400, 1)]);
    }
}
