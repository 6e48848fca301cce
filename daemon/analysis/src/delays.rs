//! Summary of one-way delays and round trips over several seconds: verdict, median, smallest.

use peernet_clock::{Span, Verdict};
use peernet_statistics::Summary;
use peernet_stream::{DelayPoint, DelaySecond, RoundTrip};

use crate::order::SortedValues;
use crate::transfer::speed_between;

/// Summary of the one-way delays of one direction over several seconds.
#[derive(Clone, Debug, Default)]
pub struct DelaySummary {
    /// Number of judged delays.
    count: u64,
    /// Median of each second, with its weight.
    medians: Vec<(DelayPoint, u64)>,
    /// Sum of the weights of the seconds with each verdict.
    verdicts: Vec<(Verdict, u64)>,
}

impl DelaySummary {
    /// Adds the delays of a second.
    pub fn add(&mut self, second: &DelaySecond) {
        // A judged second has at least the weight 1.
        let weight = u64::from(second.count.max(1));
        self.count += u64::from(second.count);
        // A negative delay is impossible, so it is left out.
        self.medians
            .extend(second.median.filter(|point| !point.value.is_negative()).map(|point| (point, weight)));
        match self.verdicts.iter_mut().find(|(verdict, _)| *verdict == second.verdict) {
            Some((_, weights)) => *weights += weight,
            None => self.verdicts.push((second.verdict, weight)),
        }
    }

    /// Returns the number of judged delays.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the median of the medians of all seconds, each weighted by its number of delays. The result has the bounds of the
    /// second that it comes from. `None` if no second has a median.
    pub fn median(&self) -> Option<DelayPoint> {
        let mut medians = self.medians.clone();
        medians.sort_unstable_by_key(|(point, _)| point.value);
        let half = medians.iter().map(|(_, weight)| weight).sum::<u64>().div_ceil(2);
        let mut cumulative_weight = 0;
        let median = medians.into_iter().find(|(_, weight)| {
            cumulative_weight += weight;
            cumulative_weight >= half
        });
        median.map(|(point, _)| point)
    }

    /// Returns the worst verdict that the seconds with at least a twentieth of the delays have; `None` if no delay was judged. Single delays may
    /// have a better verdict that prevails, because a second has the verdict of a twentieth of its delays.
    pub fn verdict(&self) -> Option<Verdict> {
        Verdict::prevailing(self.verdicts.iter().copied())
    }

    /// Returns all seconds as one; `None` if no delay was judged.
    pub fn second(&self) -> Option<DelaySecond> {
        let count = u32::try_from(self.count).unwrap_or(u32::MAX);
        Some(DelaySecond { count, median: self.median(), verdict: self.verdict()? })
    }
}

impl<'a> FromIterator<&'a DelaySecond> for DelaySummary {
    fn from_iter<I: IntoIterator<Item = &'a DelaySecond>>(seconds: I) -> Self {
        seconds.into_iter().fold(Self::default(), |mut sum, second| {
            sum.add(second);
            sum
        })
    }
}

/// Returns the median of the lower bounds and the median of the upper bounds of all values. If each true value lies between its bounds, the
/// median of the true values lies between these medians. `None` unless every value has bounds, because the median of values of which some may
/// be anywhere may be anywhere, too.
pub fn median_bounds(bounds: impl Iterator<Item = Option<(f64, f64)>>) -> Option<(f64, f64)> {
    let (lower, upper): (Vec<f64>, Vec<f64>) = bounds.collect::<Option<Vec<_>>>()?.into_iter().unzip();
    let median = |values: Vec<f64>| values.into_iter().collect::<SortedValues>().median();
    median(lower).zip(median(upper))
}

/// Returns the median width of bounds, which belong to delays that have a value; `None` without bounds.
pub(crate) fn median_width(bounds: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    bounds.map(|(lo, hi)| hi - lo).collect::<SortedValues>().median()
}

/// Returns the interval of the median of delays that are summed up: the median minus and plus the median of half the widths of their bounds, at
/// least 0, because no message arrives before it was sent. Sketches of delays and widths do not say which width belongs to which delay, so this
/// interval is that of [`median_bounds`] only if all bounds are about equally wide; files have the bounds of each value and use that function.
pub fn interval_of_median(median: f64, median_half_width: f64) -> (f64, f64) {
    ((median - median_half_width).max(0.0), median + median_half_width)
}

/// Stored values of a quantity that depends on two clocks.
#[derive(Clone, Copy, Debug)]
pub struct ClockedSummaries<'a> {
    /// The quantity: the delays themselves, or the throughputs of messages with these delays.
    pub values: &'a Summary,
    /// Delays, seconds.
    pub delays: &'a Summary,
    /// Half the widths of the bounds of the delays, seconds.
    pub half_widths: &'a Summary,
}

impl ClockedSummaries<'_> {
    /// Returns the interval of the median delay. `None` unless every delay has bounds, as for [`median_bounds`].
    pub fn interval_of_median_delay(&self) -> Option<(f64, f64)> {
        Some(interval_of_median(self.delays.quantile(0.5)?, self.median_half_width()?))
    }

    /// Returns the interval of the median throughput: the number of bytes that the median throughput transfers in the median delay, divided by
    /// the ends of the delay's interval. It has no upper end if the delay may be zero. It is the interval of [`median_bounds`] of the
    /// throughputs in a file only if all messages have about the same size and equally wide bounds. `None` unless every delay has bounds.
    pub fn interval_of_median_throughput(&self) -> Option<(f64, Option<f64>)> {
        let (throughput, delay) = (self.values.quantile(0.5)?, self.delays.quantile(0.5)?);
        Some(speed_between(throughput, delay, self.median_half_width()?))
    }

    fn median_half_width(&self) -> Option<f64> {
        // A delay without bounds may be anywhere, and so may the median.
        self.half_widths.quantile(0.5).filter(|_| self.half_widths.count() >= self.delays.count())
    }
}

/// Returns the round trips of several seconds as one: the smallest minimum and the median of the medians. If there are two medians in the
/// middle, the smaller is used. `None` without seconds.
pub fn merged_round_trip(seconds: impl IntoIterator<Item = RoundTrip>) -> Option<RoundTrip> {
    let (mut smallest, mut medians): (Option<Span>, Vec<Span>) = (None, Vec::new());
    for RoundTrip { min, median } in seconds {
        smallest = Some(smallest.map_or(min, |smallest| smallest.min(min)));
        medians.push(median);
    }
    medians.sort_unstable();
    Some(RoundTrip { min: smallest?, median: *medians.get(medians.len().saturating_sub(1) / 2)? })
}

#[cfg(test)]
mod tests {
    use peernet_clock::Interval;

    use super::*;

    fn second(count: u32, ms: Option<i64>, verdict: Verdict) -> DelaySecond {
        let point = |ms| {
            let value = Span::from_millis(ms);
            DelayPoint { value, bounds: Interval::exactly(value), bits_per_second: None }
        };
        DelaySecond { count, median: ms.map(point), verdict }
    }

    #[test]
    fn median_weighs_seconds_by_their_delays() {
        let seconds = [
            second(1, Some(9), Verdict::Ok),
            second(10, Some(3), Verdict::Ok),
            second(5, Some(1), Verdict::Ok),
        ];
        let sum: DelaySummary = seconds.iter().collect();
        assert_eq!((sum.count(), sum.median().map(|point| point.value)), (16, Some(Span::from_millis(3))));
        let negative: DelaySummary =
            [second(9, Some(-2), Verdict::Ok), second(1, None, Verdict::Ok)].iter().collect();
        assert_eq!(negative.second().expect("judged").median, None);
        assert_eq!(DelaySummary::default().second(), None);
    }

    fn summary(values: impl Iterator<Item = f64>) -> Summary {
        let mut summary = Summary::default();
        values.for_each(|value| summary.record(value));
        summary
    }

    #[test]
    fn verdict_on_several_seconds_judges_whole_seconds() {
        // Agents report one verdict per second: 10 delays of which 1 is limited are a limited second.
        let verdicts = [(Verdict::Ok, 9), (Verdict::Limited, 1)];
        let limited = second(10, Some(3), Verdict::prevailing(verdicts).expect("delays"));
        let seconds = [vec![limited; 4], vec![second(10, Some(3), Verdict::Ok); 6]].concat();
        assert_eq!(seconds.iter().collect::<DelaySummary>().verdict(), Some(Verdict::Limited));
        let single_delays = [(Verdict::Ok, 96), (Verdict::Limited, 4)];
        assert_eq!(Verdict::prevailing(single_delays), Some(Verdict::Ok));
    }

    #[test]
    fn files_and_summaries_agree_on_equally_wide_bounds() {
        const HALF_WIDTH: f64 = 0.4e-3;
        let bits = 8.0 * 40e3;
        let all: Vec<f64> = (0..1_000).map(|number| 5e-3 + f64::from(number * 37 % 1_000) * 1e-6).collect();
        let bounds = |delay: &f64| (delay - HALF_WIDTH, delay + HALF_WIDTH);
        let delays = median_bounds(all.iter().map(|delay| Some(bounds(delay)))).expect("bounds");
        let throughputs = all.iter().map(bounds).map(|(lo, hi)| Some((bits / hi, bits / lo)));
        let throughputs = median_bounds(throughputs).expect("bounds");
        let stored = summary(all.iter().copied());
        let half_widths = summary(all.iter().map(|_| HALF_WIDTH));
        let of_delays = ClockedSummaries { values: &stored, delays: &stored, half_widths: &half_widths };
        let rates = summary(all.iter().map(|delay| bits / delay));
        let of_throughputs = ClockedSummaries { values: &rates, ..of_delays };
        let (lo, hi) = of_throughputs.interval_of_median_throughput().expect("bounds");
        let pairs = [
            (delays, of_delays.interval_of_median_delay().expect("bounds")),
            (throughputs, (lo, hi.expect("the delay is above zero"))),
        ];
        for (file, page) in pairs {
            // Each of the sketches is within 1 %.
            let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.02;
            assert!(near(file.0, page.0) && near(file.1, page.1), "{file:?} {page:?}");
        }
        assert_eq!(interval_of_median(1e-3, 4e-3), (0.0, 5e-3));
    }

    #[test]
    fn median_has_no_interval_unless_every_delay_has_bounds() {
        assert_eq!(
            [median_bounds([Some((0.0, 1.0)), None].into_iter()), median_bounds(std::iter::empty())],
            [None, None]
        );
        let (delays, half_widths) = (summary([1e-3; 40].into_iter()), summary([1e-4; 39].into_iter()));
        let some = ClockedSummaries { values: &delays, delays: &delays, half_widths: &half_widths };
        assert_eq!((some.interval_of_median_delay(), some.interval_of_median_throughput()), (None, None));
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
