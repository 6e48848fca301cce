//! Assignment of times to the relation periods of a clock relation.

use peernet_clock::{RawTime, Span};

/// Time by which the first relation period is extended before its start, and the last relation period after its end.
/// The bounds of an exchange hold for some seconds around the exchange if nothing indicates a step.
const EXTENSION: Span = Span::from_seconds(10);
/// Length of the period that a sample describes; the period ends at the sample's time.
const SAMPLE_PERIOD: Span = Span::from_seconds(1);
/// Time after a relation period's last sample in which the relation period is still possible. During the second in
/// which a clock is stepped, the relation period has exchanges but no sample: the sample of this second belongs to the
/// next relation period, and it may be late.
const MAX_UNSAMPLED: Span = Span::from_seconds(2);
/// Upper limit of an exchange's duration. A stamp that is further away from the relation period's samples is invalid
/// and is clamped to this distance.
const MAX_EXCHANGE: Span = Span::from_seconds(60);

/// Times of the first and the last stored exchange of one relation period, by the edge's clock that stamped the
/// exchanges.
#[derive(Clone, Copy, Debug)]
pub(super) struct PeriodExtent {
    /// End of the first second with an exchange.
    pub(super) first: RawTime,
    /// End of the last second with an exchange.
    pub(super) last: RawTime,
    /// Time at which the first exchange was sent.
    pub(super) sent: RawTime,
    /// Time at which the last exchange returned.
    pub(super) returned: RawTime,
}

/// The time of a clock of the edge, divided into intervals. If exactly one relation period is possible during an
/// interval, the interval has this relation period.
///
/// A relation period is certain from its first exchange to its last exchange. A relation period is possible during the
/// whole seconds of its samples. Two relation periods may be possible at the same time: free-running clocks count from
/// the start of the machine, so the same time may occur after two starts; and the edge's wall clock may have been set
/// back. Such a time belongs to no relation period. A time between two relation periods, where a clock was stepped,
/// belongs to no relation period, either.
#[derive(Debug, Default)]
pub(super) struct Timeline {
    /// Start of each interval, with the index of its relation period if exactly one relation period is possible. If
    /// several relation periods begin or end at the same time, the last entry with this time is valid.
    intervals: Vec<(RawTime, Option<usize>)>,
    /// Range of times in which each relation period is certain.
    certain_ranges: Vec<(RawTime, RawTime)>,
}

impl Timeline {
    /// Creates the timeline of relation periods in any order. A relation period is identified by its index in
    /// `periods`.
    pub(super) fn new(periods: &[PeriodExtent]) -> Self {
        let mut certain_ranges: Vec<(RawTime, RawTime)> = periods
            .iter()
            .map(|period| {
                (
                    period.sent.max(period.first - MAX_EXCHANGE),
                    period.returned.min(period.last + MAX_EXCHANGE),
                )
            })
            .collect();
        let mut possible_ranges: Vec<(RawTime, RawTime)> = periods
            .iter()
            .zip(&certain_ranges)
            .map(|(period, (sent, returned))| {
                ((period.first - SAMPLE_PERIOD).min(*sent), (period.last + MAX_UNSAMPLED).max(*returned))
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
        for (period, (start, end)) in possible_ranges.into_iter().enumerate() {
            // A range includes its end, so the relation period is no longer possible one nanosecond after the end.
            changes.push((start, true, period));
            changes.push((end + Span::from_nanos(1), false, period));
        }
        changes.sort_unstable();
        // A set of open relation periods is not needed: if one relation period is open, the sum of the indexes of open
        // relation periods is the index of this relation period.
        let (mut open_periods, mut index_sum) = (0_usize, 0_usize);
        let mut intervals = Vec::with_capacity(changes.len());
        for (at, opens, period) in changes {
            (open_periods, index_sum) = if opens {
                (open_periods + 1, index_sum + period)
            } else {
                (open_periods - 1, index_sum - period)
            };
            intervals.push((at, (open_periods == 1).then_some(index_sum)));
        }
        Self { intervals, certain_ranges }
    }

    /// Returns the index of the relation period to which a time belongs. `None` if no relation period is certain at
    /// this time, or if more than one relation period is possible.
    pub(super) fn period(&self, at: RawTime) -> Option<usize> {
        let next_interval = self.intervals.partition_point(|(start, _)| *start <= at);
        let period = self.intervals.get(next_interval.checked_sub(1)?)?.1?;
        let (start, end) = self.certain_ranges.get(period)?;
        (*start <= at && at <= *end).then_some(period)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn raw(seconds: i64) -> RawTime {
        RawTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    fn period(first: i64, last: i64) -> PeriodExtent {
        PeriodExtent { first: raw(first), last: raw(last), sent: raw(first), returned: raw(last) }
    }

    fn periods(timeline: &Timeline, times: &[i64]) -> Vec<Option<usize>> {
        times.iter().map(|at| timeline.period(raw(*at))).collect()
    }

    #[test]
    fn single_period_extends_ten_seconds_beyond_its_exchanges() {
        let timeline = Timeline::new(&[period(100, 200)]);
        assert_eq!(
            periods(&timeline, &[89, 90, 100, 150, 200, 210, 211]),
            [None, Some(0), Some(0), Some(0), Some(0), Some(0), None]
        );
        assert_eq!(Timeline::new(&[]).period(raw(0)), None);
    }

    #[test]
    fn time_between_periods_belongs_to_no_period() {
        let timeline = Timeline::new(&[period(300, 400), period(100, 200)]);
        assert_eq!(
            periods(&timeline, &[95, 200, 201, 299, 300, 405]),
            [Some(1), Some(1), None, None, Some(0), Some(0)]
        );
    }

    #[test]
    fn repeated_time_of_edge_belongs_to_no_period() {
        // The clock was set back by 50 s after 200. The first relation period is possible until 202 (`MAX_UNSAMPLED`),
        // and the second is possible from 150 on (`SAMPLE_PERIOD`).
        let timeline = Timeline::new(&[period(100, 200), period(151, 300)]);
        assert_eq!(periods(&timeline, &[149, 150, 202, 203]), [Some(0), None, None, Some(1)]);
    }

    #[test]
    fn invalid_stamps_of_period_change_no_other_period() {
        let invalid = PeriodExtent {
            first: raw(300),
            last: raw(301),
            sent: RawTime::from_nanos(i64::MIN),
            returned: RawTime::from_nanos(i64::MAX),
        };
        // The invalid stamps are clamped to 240 and 361, and the last relation period is extended to 371.
        let timeline = Timeline::new(&[period(100, 200), invalid]);
        assert_eq!(periods(&timeline, &[150, 239, 372]), [Some(0), None, None]);
    }

    proptest! {
        #[test]
        fn any_stamps_give_valid_period_or_none(
            stamps in prop::collection::vec((any::<i64>(), any::<i64>(), any::<i64>(), any::<i64>()), 0..8), at: i64,
        ) {
            let at_nanos = RawTime::from_nanos;
            let extents: Vec<PeriodExtent> = stamps
                .into_iter()
                .flat_map(|(first, last, sent, returned)| [(first, last, sent, returned), (i64::MIN, i64::MAX, last, sent)])
                .map(|(first, last, sent, returned)| PeriodExtent {
                    first: at_nanos(first.min(last)),
                    last: at_nanos(first.max(last)),
                    sent: at_nanos(sent),
                    returned: at_nanos(returned),
                })
                .collect();
            let period = Timeline::new(&extents).period(at_nanos(at));
            prop_assert!(period.is_none_or(|period| period < extents.len()));
        }
    }
}
