//! Summaries over several seconds: verdict and median of one-way delays, minimum and median of round trips.

mod median_interval;
mod verdict_counts;

use peernet_clock::{Interval, Span, Verdict};
use peernet_stream::{DelayPoint, DelaySecond, RoundTrip};

pub use self::median_interval::{
    ClockInterval, ClockedSummaries, CountedAverage, DelayAverages, IntervalMethod, median_bounds,
};
pub use self::verdict_counts::VerdictCounts;
use crate::order::{SortedValues, weighted_median};

/// Summary of the one-way delays of one direction over several seconds.
#[derive(Clone, Debug, Default)]
pub struct DelaySummary {
    /// Number of judged delays.
    count: u64,
    /// Median of each second, with the weight of the second.
    medians: Vec<(DelayPoint, u64)>,
    /// Sum of the weights of the seconds with each verdict.
    verdicts: VerdictCounts,
}

impl DelaySummary {
    /// Adds the delays of a second.
    pub fn add(&mut self, second: &DelaySecond) {
        // A second with a verdict has at least one judged delay, even if its stored count is 0.
        let weight = u64::from(second.count.max(1));
        self.count += u64::from(second.count);
        self.medians.extend(second.median.map(|point| (point, weight)));
        self.verdicts.add(second.verdict, weight);
    }

    /// Returns the number of judged delays.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the [median](median_delay) of the medians of all seconds. Each second has its number of delays as
    /// weight. `None` if no second has a median.
    pub fn median(&self) -> Option<DelayPoint> {
        median_delay(|key| weighted_median(self.medians.clone(), |a, b| key(a).cmp(&key(b))))
    }

    /// Returns the [summary verdict](Verdict::summarise) of all delays; `None` if no delay was judged. A delay counts
    /// with the verdict of its second, which may be worse than its own.
    pub fn verdict(&self) -> Option<Verdict> {
        Verdict::summarise(self.verdicts.counts())
    }

    /// Returns all seconds as if they were one; `None` if no delay was judged.
    pub fn to_delay_second(&self) -> Option<DelaySecond> {
        let count = u32::try_from(self.count).unwrap_or(u32::MAX);
        Some(DelaySecond { count, median: self.median(), verdict: self.verdict()? })
    }
}

impl<'a> FromIterator<&'a DelaySecond> for DelaySummary {
    fn from_iter<I: IntoIterator<Item = &'a DelaySecond>>(seconds: I) -> Self {
        seconds.into_iter().fold(Self::default(), |mut summary, second| {
            summary.add(second);
            summary
        })
    }
}

/// Returns the median delay. Its bounds are the medians of all lower and of all upper bounds, between which the median
/// of the true delays lies, as in [`median_bounds`]. `median_by` returns the delay whose key is the median; `None`
/// without delays.
pub fn median_delay(median_by: impl Fn(fn(&DelayPoint) -> Span) -> Option<DelayPoint>) -> Option<DelayPoint> {
    let lo = median_by(|point| point.bounds.lo)?.bounds.lo;
    let hi = median_by(|point| point.bounds.hi)?.bounds.hi;
    Some(DelayPoint { bounds: Interval { lo, hi }, ..median_by(|point| point.value)? })
}

/// Returns the median width of these bounds; `None` without bounds.
pub(crate) fn median_width(bounds: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    bounds.map(|(lo, hi)| hi - lo).collect::<SortedValues>().median()
}

/// Returns the round trips of several seconds as one: the smallest minimum and the median of the medians. Of two
/// medians in the middle, the smaller is returned. `None` without seconds.
pub fn merged_round_trip(seconds: impl IntoIterator<Item = RoundTrip>) -> Option<RoundTrip> {
    let (mut smallest, mut medians): (Option<Span>, Vec<(Span, u64)>) = (None, Vec::new());
    for RoundTrip { min, median } in seconds {
        smallest = Some(smallest.map_or(min, |smallest| smallest.min(min)));
        medians.push((median, 1));
    }
    Some(RoundTrip { min: smallest?, median: weighted_median(medians, Span::cmp)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second(count: u32, ms: Option<i64>, verdict: Verdict) -> DelaySecond {
        let point = |ms| {
            let value = Span::from_millis(ms);
            DelayPoint { value, bounds: Interval::exactly(value), bits_per_second: None }
        };
        DelaySecond { count, median: ms.map(point), verdict }
    }

    #[test]
    fn median_weights_seconds_by_number_of_delays() {
        let seconds = [
            second(1, Some(9), Verdict::Ok),
            second(10, Some(3), Verdict::Ok),
            second(5, Some(1), Verdict::Ok),
        ];
        let summary: DelaySummary = seconds.iter().collect();
        assert_eq!(
            (summary.count(), summary.median().map(|point| point.value)),
            (16, Some(Span::from_millis(3)))
        );
        let unknown: DelaySummary = [second(1, None, Verdict::Ok)].iter().collect();
        assert_eq!(unknown.to_delay_second().expect("judged").median, None);
        assert_eq!(DelaySummary::default().to_delay_second(), None);
    }

    #[test]
    fn median_of_seconds_has_median_bounds() {
        // The second in the middle has the narrowest bounds; the other seconds have wider bounds.
        let seconds = [(4, 1, 9), (5, 4, 6), (6, 2, 12)].map(|(value, lo, hi)| {
            let [value, lo, hi] = [value, lo, hi].map(Span::from_millis);
            let point = DelayPoint { value, bounds: Interval { lo, hi }, bits_per_second: None };
            DelaySecond { count: 1, median: Some(point), verdict: Verdict::Ok }
        });
        let median = seconds.iter().collect::<DelaySummary>().median().expect("medians");
        let ends = [median.bounds.lo, median.value, median.bounds.hi];
        assert_eq!(ends, [2, 5, 9].map(Span::from_millis));
    }

    #[test]
    fn verdict_of_second_counts_for_all_its_delays() {
        // Agents report one verdict per second. A second of 10 delays, of which 1 is limited, has the verdict limited.
        let verdicts = [(Verdict::Ok, 9), (Verdict::Limited, 1)];
        let limited = second(10, Some(3), Verdict::summarise(verdicts).expect("delays"));
        let seconds = [vec![limited; 4], vec![second(10, Some(3), Verdict::Ok); 6]].concat();
        assert_eq!(seconds.iter().collect::<DelaySummary>().verdict(), Some(Verdict::Limited));
        // With a separate verdict for each of the same 100 delays, the summary is `Ok`.
        let single_delays = [(Verdict::Ok, 96), (Verdict::Limited, 4)];
        assert_eq!(Verdict::summarise(single_delays), Some(Verdict::Ok));
    }

    #[test]
    fn merged_round_trip_has_minimum_and_lower_median() {
        let trips = [(3, 5), (1, 9), (2, 4), (4, 6)].map(|(min, median)| RoundTrip {
            min: Span::from_millis(min),
            median: Span::from_millis(median),
        });
        let merged = merged_round_trip(trips).expect("round trips");
        assert_eq!((merged.min, merged.median), (Span::from_millis(1), Span::from_millis(5)));
        assert_eq!(merged_round_trip([]), None);
    }
}
