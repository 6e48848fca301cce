//! Assignment of times to the windows of a clock relation.

use peernet_clock::{RawTime, Span};

/// Reach of the first and the last window beyond their ends: the bounds of an exchange hold for some seconds around it, if
/// there is no sign of a step.
const REACH: Span = Span::from_seconds(10);
/// A sample is for the second that ends with it.
const SECOND: Span = Span::from_seconds(1);
/// Time after a window's last sample for which the window is still possible. The second of a step has a sample of the later
/// window only, and that sample may arrive late.
const MAX_UNSAMPLED: Span = Span::from_seconds(2);
/// Upper limit of an exchange's duration; earlier stamps are invalid.
const MAX_EXCHANGE: Span = Span::from_seconds(60);

/// Range of the stored exchanges of one window, by the edge's clock that stamped them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    /// End of the first second with an exchange.
    pub(super) first: RawTime,
    /// End of the last second with an exchange.
    pub(super) last: RawTime,
    /// Time at which the first exchange was sent.
    pub(super) sent: RawTime,
    /// Time at which the last exchange returned.
    pub(super) returned: RawTime,
}

/// The time of a clock of the edge, divided into intervals. Each interval has the window that is possible in it, if there is
/// exactly one.
///
/// Free-running clocks count from the start of their machine: a time that occurs after two starts of the machine belongs to
/// neither window. Near a step two windows may overlap, if the edge's clock was set back, or leave a gap in which the step
/// happened: a time there belongs to neither window. A window is certain from its first exchange to its last one. It is possible
/// for the whole seconds of its samples, where no other window is certain.
#[derive(Debug, Default)]
pub(super) struct Timeline {
    /// Starts of the pieces with the only possible window.
    pieces: Vec<(RawTime, Option<usize>)>,
    /// Range in which each window is certain.
    certain: Vec<(RawTime, RawTime)>,
}

impl Timeline {
    /// Makes the timeline of windows in any order; their indexes are their names.
    pub(super) fn new(windows: &[Extent]) -> Self {
        let mut certain: Vec<(RawTime, RawTime)> = windows
            .iter()
            .map(|window| {
                (
                    window.sent.max(window.first - MAX_EXCHANGE),
                    window.returned.min(window.last + MAX_EXCHANGE),
                )
            })
            .collect();
        let mut possible: Vec<(RawTime, RawTime)> = windows
            .iter()
            .zip(&certain)
            .map(|(window, (sent, returned))| {
                ((window.first - SECOND).min(*sent), (window.last + MAX_UNSAMPLED).max(*returned))
            })
            .collect();
        for spans in [&mut certain, &mut possible] {
            if let Some(first) = spans.iter_mut().min_by_key(|(begin, _)| *begin) {
                first.0 = first.0 - REACH;
            }
            if let Some(last) = spans.iter_mut().max_by_key(|(_, end)| *end) {
                last.1 = last.1 + REACH;
            }
        }
        let mut changes: Vec<(RawTime, bool, usize)> = Vec::with_capacity(2 * possible.len());
        for (window, (begin, end)) in possible.into_iter().enumerate() {
            changes.push((begin, true, window));
            changes.push((end + Span::from_nanos(1), false, window));
        }
        changes.sort_unstable();
        // Of the open windows only the number and the sum of the indexes are kept: the sum of one is its index.
        let (mut open, mut sum) = (0_usize, 0_usize);
        let mut pieces = Vec::with_capacity(changes.len());
        for (at, opens, window) in changes {
            (open, sum) = if opens { (open + 1, sum + window) } else { (open - 1, sum - window) };
            pieces.push((at, (open == 1).then_some(sum)));
        }
        Self { pieces, certain }
    }

    /// Returns the window of a time, or `None` if it is not certain.
    pub(super) fn window(&self, at: RawTime) -> Option<usize> {
        let after = self.pieces.partition_point(|(begin, _)| *begin <= at);
        let window = self.pieces.get(after.checked_sub(1)?)?.1?;
        let (begin, end) = self.certain.get(window)?;
        (*begin <= at && at <= *end).then_some(window)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn raw(seconds: i64) -> RawTime {
        RawTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    fn window(first: i64, last: i64) -> Extent {
        Extent { first: raw(first), last: raw(last), sent: raw(first), returned: raw(last) }
    }

    fn windows(timeline: &Timeline, times: &[i64]) -> Vec<Option<usize>> {
        times.iter().map(|at| timeline.window(raw(*at))).collect()
    }

    #[test]
    fn window_extends_little_beyond_its_exchanges() {
        let timeline = Timeline::new(&[window(100, 200)]);
        assert_eq!(
            windows(&timeline, &[89, 90, 100, 150, 200, 210, 211]),
            [None, Some(0), Some(0), Some(0), Some(0), Some(0), None]
        );
        assert_eq!(Timeline::new(&[]).window(raw(0)), None);
    }

    #[test]
    fn time_between_windows_belongs_to_no_window() {
        let timeline = Timeline::new(&[window(300, 400), window(100, 200)]);
        assert_eq!(
            windows(&timeline, &[95, 200, 201, 299, 300, 405]),
            [Some(1), Some(1), None, None, Some(0), Some(0)]
        );
    }

    #[test]
    fn repeated_time_of_edge_belongs_to_no_window() {
        // The clock was set back by 50 s after 200.
        let timeline = Timeline::new(&[window(100, 200), window(151, 300)]);
        assert_eq!(windows(&timeline, &[149, 150, 202, 203]), [Some(0), None, None, Some(1)]);
    }

    #[test]
    fn extreme_stamps_do_not_move_windows() {
        let wild = Extent {
            first: raw(300),
            last: raw(301),
            sent: RawTime::from_nanos(i64::MIN),
            returned: RawTime::from_nanos(i64::MAX),
        };
        let timeline = Timeline::new(&[window(100, 200), wild]);
        assert_eq!(windows(&timeline, &[150, 239, 372]), [Some(0), None, None]);
    }

    proptest! {
        #[test]
        fn any_stamps_name_at_most_one_window(
            stamps in prop::collection::vec((any::<i64>(), any::<i64>(), any::<i64>(), any::<i64>()), 0..8), at: i64,
        ) {
            let at_nanos = RawTime::from_nanos;
            let extents: Vec<Extent> = stamps
                .into_iter()
                .flat_map(|(first, last, sent, returned)| [(first, last, sent, returned), (i64::MIN, i64::MAX, last, sent)])
                .map(|(first, last, sent, returned)| Extent {
                    first: at_nanos(first.min(last)),
                    last: at_nanos(first.max(last)),
                    sent: at_nanos(sent),
                    returned: at_nanos(returned),
                })
                .collect();
            let window = Timeline::new(&extents).window(at_nanos(at));
            prop_assert!(window.is_none_or(|window| window < extents.len()));
        }
    }
}
