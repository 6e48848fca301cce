//! Assignment of times to the windows of a clock relation.

use peernet_clock::{RawTime, Span};

/// Time by which the first window is extended before its start, and the last window after its end. The bounds of an
/// exchange hold for some seconds around the exchange if nothing indicates a step.
const EXTENSION: Span = Span::from_seconds(10);
/// Length of the period that a sample describes; the period ends at the sample's time.
const SAMPLE_PERIOD: Span = Span::from_seconds(1);
/// Time after a window's last sample in which the window is still possible. During the second in which a clock is
/// stepped, the window has exchanges but no sample: the sample of this second belongs to the next window, and it may be
/// late.
const MAX_UNSAMPLED: Span = Span::from_seconds(2);
/// Upper limit of an exchange's duration. A stamp that is further away from the window's samples is invalid and is
/// clamped to this distance.
const MAX_EXCHANGE: Span = Span::from_seconds(60);

/// Times of the first and the last stored exchange of one window, by the edge's clock that stamped the exchanges.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowExtent {
    /// End of the first second with an exchange.
    pub(super) first: RawTime,
    /// End of the last second with an exchange.
    pub(super) last: RawTime,
    /// Time at which the first exchange was sent.
    pub(super) sent: RawTime,
    /// Time at which the last exchange returned.
    pub(super) returned: RawTime,
}

/// The time of a clock of the edge, divided into intervals. If exactly one window is possible during an interval, the
/// interval has this window.
///
/// A window is certain from its first exchange to its last exchange. A window is possible during the whole seconds of
/// its samples. Two windows may be possible at the same time: free-running clocks count from the start of the machine,
/// so the same time may occur after two starts; and the edge's wall clock may have been set back. Such a time belongs
/// to no window. A time between two windows, where a clock was stepped, belongs to no window, either.
#[derive(Debug, Default)]
pub(super) struct Timeline {
    /// Start of each interval, with the index of its window if exactly one window is possible. If several windows begin
    /// or end at the same time, the last entry with this time is valid.
    intervals: Vec<(RawTime, Option<usize>)>,
    /// Range of times in which each window is certain.
    certain_ranges: Vec<(RawTime, RawTime)>,
}

impl Timeline {
    /// Creates the timeline of windows in any order. A window is identified by its index in `windows`.
    pub(super) fn new(windows: &[WindowExtent]) -> Self {
        let mut certain_ranges: Vec<(RawTime, RawTime)> = windows
            .iter()
            .map(|window| {
                (
                    window.sent.max(window.first - MAX_EXCHANGE),
                    window.returned.min(window.last + MAX_EXCHANGE),
                )
            })
            .collect();
        let mut possible_ranges: Vec<(RawTime, RawTime)> = windows
            .iter()
            .zip(&certain_ranges)
            .map(|(window, (sent, returned))| {
                ((window.first - SAMPLE_PERIOD).min(*sent), (window.last + MAX_UNSAMPLED).max(*returned))
            })
            .collect();
        for ranges in [&mut certain_ranges, &mut possible_ranges] {
            if let Some(first) = ranges.iter_mut().min_by_key(|(start, _)| *start) {
                first.0 = first.0 - EXTENSION;
            }
            if let Some(last) = ranges.iter_mut().max_by_key(|(_, end)| *end) {
                last.1 = last.1 + EXTENSION;
            }
        }
        let mut changes: Vec<(RawTime, bool, usize)> = Vec::with_capacity(2 * possible_ranges.len());
        for (window, (start, end)) in possible_ranges.into_iter().enumerate() {
            // A range includes its end, so the window is no longer possible one nanosecond after the end.
            changes.push((start, true, window));
            changes.push((end + Span::from_nanos(1), false, window));
        }
        changes.sort_unstable();
        // A set of open windows is not needed: if one window is open, the sum of the indexes of open windows is the
        // index of this window.
        let (mut open_windows, mut index_sum) = (0_usize, 0_usize);
        let mut intervals = Vec::with_capacity(changes.len());
        for (at, opens, window) in changes {
            (open_windows, index_sum) = if opens {
                (open_windows + 1, index_sum + window)
            } else {
                (open_windows - 1, index_sum - window)
            };
            intervals.push((at, (open_windows == 1).then_some(index_sum)));
        }
        Self { intervals, certain_ranges }
    }

    /// Returns the index of the window to which a time belongs. `None` if no window is certain at this time, or if more
    /// than one window is possible.
    pub(super) fn window(&self, at: RawTime) -> Option<usize> {
        let next_interval = self.intervals.partition_point(|(start, _)| *start <= at);
        let window = self.intervals.get(next_interval.checked_sub(1)?)?.1?;
        let (start, end) = self.certain_ranges.get(window)?;
        (*start <= at && at <= *end).then_some(window)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn raw(seconds: i64) -> RawTime {
        RawTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    fn window(first: i64, last: i64) -> WindowExtent {
        WindowExtent { first: raw(first), last: raw(last), sent: raw(first), returned: raw(last) }
    }

    fn windows(timeline: &Timeline, times: &[i64]) -> Vec<Option<usize>> {
        times.iter().map(|at| timeline.window(raw(*at))).collect()
    }

    #[test]
    fn single_window_extends_ten_seconds_beyond_its_exchanges() {
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
    fn invalid_stamps_of_window_change_no_other_window() {
        let invalid = WindowExtent {
            first: raw(300),
            last: raw(301),
            sent: RawTime::from_nanos(i64::MIN),
            returned: RawTime::from_nanos(i64::MAX),
        };
        let timeline = Timeline::new(&[window(100, 200), invalid]);
        assert_eq!(windows(&timeline, &[150, 239, 372]), [Some(0), None, None]);
    }

    proptest! {
        #[test]
        fn any_stamps_give_valid_window_or_none(
            stamps in prop::collection::vec((any::<i64>(), any::<i64>(), any::<i64>(), any::<i64>()), 0..8), at: i64,
        ) {
            let at_nanos = RawTime::from_nanos;
            let extents: Vec<WindowExtent> = stamps
                .into_iter()
                .flat_map(|(first, last, sent, returned)| [(first, last, sent, returned), (i64::MIN, i64::MAX, last, sent)])
                .map(|(first, last, sent, returned)| WindowExtent {
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
