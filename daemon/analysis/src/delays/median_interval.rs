//! Interval of the median of delays and throughputs by the clock bounds: from single values, and from stored statistics.

use peernet_statistics::Summary;

use crate::order::SortedValues;

/// Returns the median of the lower bounds and the median of the upper bounds of all values. If each true value lies between its bounds, the
/// median of the true values lies between these medians. `None` unless every value has bounds, because the median of values of which some may
/// be anywhere may be anywhere, too.
pub fn median_bounds(bounds: impl Iterator<Item = Option<(f64, f64)>>) -> Option<(f64, f64)> {
    let (lower, upper): (Vec<f64>, Vec<f64>) = bounds.collect::<Option<Vec<_>>>()?.into_iter().unzip();
    let median = |values: Vec<f64>| values.into_iter().collect::<SortedValues>().median();
    median(lower).zip(median(upper))
}

/// Number of values of a quantity, and their median or mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CountedAverage {
    /// Number of values.
    pub count: u64,
    /// Their median or mean, in the SI unit.
    pub value: f64,
}

impl CountedAverage {
    /// Returns the number of values of a summary and their median, within 1 %; `None` without values.
    fn median_of(summary: &Summary) -> Option<Self> {
        Some(Self { count: summary.count(), value: summary.quantile(0.5)? })
    }
}

/// How the interval of a median or mean was computed from stored statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalMethod {
    /// From the lower and the upper ends of all intervals, as [`median_bounds`] from single values.
    Ends,
    /// From half the widths of all intervals, because an earlier version recorded the values and no ends. It differs from [`median_bounds`] if the
    /// values do not lie in the middle of their intervals, or if these are not equally wide.
    HalfWidths,
}

impl IntervalMethod {
    /// Returns the words that stand beside an interval whose ends may be off; `None` for the exact method.
    pub const fn remark(self) -> Option<&'static str> {
        match self {
            Self::Ends => None,
            Self::HalfWidths => Some("from half widths"),
        }
    }
}

/// Interval by the clock bounds of the median or mean of a delay or throughput, from stored statistics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockInterval {
    /// Lower end.
    pub lo: f64,
    /// Upper end; infinite for a throughput whose delay may be zero.
    pub hi: f64,
    /// How the ends were computed.
    pub method: IntervalMethod,
}

impl ClockInterval {
    /// Returns both ends.
    pub const fn ends(&self) -> (f64, f64) {
        (self.lo, self.hi)
    }

    /// Returns the interval of a speed, of which this is the interval of the delay: the bytes that the speed transfers in `delay`, divided by the
    /// ends of this interval.
    #[must_use]
    pub fn of_speed(&self, speed: f64, delay: f64) -> Self {
        let bytes = speed * delay;
        let over = |seconds: f64| if seconds > 0.0 { bytes / seconds } else { f64::INFINITY };
        Self { lo: over(self.hi), hi: over(self.lo), method: self.method }
    }

    /// Returns the interval from an average and half the width. Its lower end is at least 0 unless delays are negative: messages of one session
    /// never arrive before they were sent, but an observed system may have negative delays.
    fn from_half_width(average: f64, half_width: f64) -> Self {
        let lo = average - half_width;
        let lo = if average < 0.0 { lo } else { lo.max(0.0) };
        Self { lo, hi: average + half_width, method: IntervalMethod::HalfWidths }
    }
}

/// Medians, or means, of the stored statistics of delays, seconds.
#[derive(Clone, Copy, Debug)]
pub struct DelayAverages {
    /// Of the delays.
    pub delay: CountedAverage,
    /// Of the lower and of the upper ends of their intervals; `None` if they are not stored.
    pub ends: Option<[CountedAverage; 2]>,
    /// Of half the widths of their intervals; `None` if no delay has an interval.
    pub half_width: Option<CountedAverage>,
}

impl DelayAverages {
    /// Returns the interval of the median delay, or of the mean delay. `None` unless every delay has an interval, as for [`median_bounds`].
    ///
    /// A delay is not below its lower end, so a median (or mean) of delays is not below that of the lower ends; and so for the upper ends.
    pub fn interval(&self) -> Option<ClockInterval> {
        // A delay without an interval may be anywhere, and so may the median.
        let is_complete = |part: &CountedAverage| part.count >= self.delay.count;
        let ends = self.ends.filter(|ends| ends.iter().all(is_complete));
        ends.map(|[lower, upper]| ClockInterval {
            lo: lower.value,
            hi: upper.value,
            method: IntervalMethod::Ends,
        })
        .or_else(|| {
            let half_width = self.half_width.filter(is_complete)?;
            Some(ClockInterval::from_half_width(self.delay.value, half_width.value))
        })
    }
}

/// Stored values of a quantity that depends on two clocks.
#[derive(Clone, Copy, Debug)]
pub struct ClockedSummaries<'a> {
    /// The quantity: the delays themselves, or the throughputs of messages with these delays.
    pub values: &'a Summary,
    /// Lower and upper ends of the intervals of these values, without infinite ones; `None` if they are not stored.
    pub ends: Option<&'a [Summary; 2]>,
    /// Delays, seconds.
    pub delays: &'a Summary,
    /// Half the widths of the intervals of the delays, seconds; `None` if no delay has an interval.
    pub half_widths: Option<&'a Summary>,
}

impl ClockedSummaries<'_> {
    /// Returns the interval of the median delay. `None` unless every delay has an interval, as for [`median_bounds`].
    pub fn interval_of_median_delay(&self) -> Option<ClockInterval> {
        self.delay_medians()?.interval()
    }

    /// Returns the interval of the median throughput. `None` unless every delay has an interval.
    ///
    /// If the ends are not stored, they are the number of bytes that the median throughput transfers in the median delay, divided by the ends of
    /// the delay's interval. These are the ends of [`median_bounds`] only if all messages have about the same size, too.
    pub fn interval_of_median_throughput(&self) -> Option<ClockInterval> {
        self.interval_from_throughput_ends().or_else(|| {
            // The ends that are stored for throughputs are no ends of delays.
            let medians = DelayAverages { ends: None, ..self.delay_medians()? };
            let interval = medians.interval()?;
            Some(interval.of_speed(self.values.quantile(0.5)?, medians.delay.value))
        })
    }

    fn delay_medians(&self) -> Option<DelayAverages> {
        Some(DelayAverages {
            delay: CountedAverage::median_of(self.delays)?,
            ends: self.ends.and_then(|[lower, upper]| {
                Some([CountedAverage::median_of(lower)?, CountedAverage::median_of(upper)?])
            }),
            half_width: self.half_widths.and_then(CountedAverage::median_of),
        })
    }

    fn interval_from_throughput_ends(&self) -> Option<ClockInterval> {
        let [lower, upper] = self.ends?;
        let count = lower.count();
        // A throughput has a lower end whenever it has an interval.
        (count > 0 && count >= self.values.count()).then_some(())?;
        let hi = upper_median(upper, count);
        Some(ClockInterval { lo: lower.quantile(0.5)?, hi, method: IntervalMethod::Ends })
    }
}

/// Returns the median of `count` upper ends of which `finite` has the finite ones.
fn upper_median(finite: &Summary, count: u64) -> f64 {
    let (rank, last) = ((count - 1) as f64 / 2.0, finite.count() as f64 - 1.0);
    if rank > last {
        return f64::INFINITY;
    }
    let share = if last > 0.0 { rank / last } else { 0.0 };
    finite.quantile(share).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use peernet_statistics::Sketch;

    use super::*;

    fn summary(values: impl Iterator<Item = f64>) -> Summary {
        let mut summary = Summary::default();
        values.for_each(|value| summary.record(value));
        summary
    }

    /// Delay with the ends of its interval, seconds.
    type Delay = (f64, f64, f64);

    /// Returns the intervals of the median from single values and from stored statistics: of the delays, and of the throughputs of messages of
    /// `bits(index)`.
    fn intervals(
        delays: &[Delay],
        bits: impl Fn(usize) -> f64,
    ) -> ([Option<(f64, f64)>; 2], [ClockInterval; 2]) {
        let throughputs = delays.iter().enumerate().map(|(index, (value, lo, hi))| {
            let rate = |seconds: f64| if seconds > 0.0 { bits(index) / seconds } else { f64::INFINITY };
            (rate(*value), rate(*hi), rate(*lo))
        });
        let throughputs: Vec<Delay> = throughputs.collect();
        let file = |all: &[Delay]| median_bounds(all.iter().map(|(_, lo, hi)| Some((*lo, *hi))));
        let ends =
            |all: &[Delay]| [summary(all.iter().map(|one| one.1)), summary(all.iter().map(|one| one.2))];
        let values = |all: &[Delay]| summary(all.iter().map(|one| one.0));
        let half_widths = summary(delays.iter().map(|(_, lo, hi)| (hi - lo) / 2.0));
        let (delay_values, delay_ends) = (values(delays), ends(delays));
        let of_delays = ClockedSummaries {
            values: &delay_values,
            ends: Some(&delay_ends),
            delays: &delay_values,
            half_widths: Some(&half_widths),
        };
        let (rates, rate_ends) = (values(&throughputs), ends(&throughputs));
        let of_throughputs = ClockedSummaries { values: &rates, ends: Some(&rate_ends), ..of_delays };
        let page = [of_delays.interval_of_median_delay(), of_throughputs.interval_of_median_throughput()];
        ([file(delays), file(&throughputs)], page.map(|interval| interval.expect("all have intervals")))
    }

    fn assert_equal(delays: &[Delay], bits: impl Fn(usize) -> f64) -> [ClockInterval; 2] {
        let (file, page) = intervals(delays, bits);
        for (file, page) in file.into_iter().zip(page) {
            let file = file.expect("all have bounds");
            let near = |a: f64, b: f64| a == b || (a - b).abs() <= Sketch::RELATIVE_ERROR * b.abs();
            assert!(near(page.lo, file.0) && near(page.hi, file.1), "{file:?} {page:?}");
            assert_eq!(page.method, IntervalMethod::Ends);
        }
        page
    }

    /// Returns a number from 0 to 1 that looks random.
    fn scattered(number: usize) -> f64 {
        (number * 379 % 1_001) as f64 / 1_001.0
    }

    #[test]
    fn page_interval_equals_file_with_cut_and_uneven_bounds() {
        // The lower ends of two fifths are cut at zero, widths differ by a factor of ten, and no value is in the middle.
        let limited = |number| {
            let value = 0.4e-3 + 2e-3 * scattered(number);
            let width = 0.2e-3 + 2e-3 * scattered(7 * number + 3);
            let lo = if number % 5 < 2 { 0.0 } else { (value - 0.1 * width).max(0.0) };
            (value, lo, value + 0.9 * width)
        };
        let delays: Vec<Delay> = (0..1_000).map(limited).collect();
        let sizes = |number: usize| 8.0 * (10e3 + 90e3 * scattered(3 * number + 1));
        let [of_delays, of_throughputs] = assert_equal(&delays, sizes);
        assert!(of_delays.lo > 0.0 && of_throughputs.hi.is_finite());
        // The median of half the widths gives other ends.
        let values = summary(delays.iter().map(|one| one.0));
        let half_widths = summary(delays.iter().map(|(_, lo, hi)| (hi - lo) / 2.0));
        let without_ends = ClockedSummaries {
            values: &values,
            ends: None,
            delays: &values,
            half_widths: Some(&half_widths),
        };
        let estimated = without_ends.interval_of_median_delay().expect("half widths");
        assert_eq!(estimated.method, IntervalMethod::HalfWidths);
        assert!((estimated.hi / of_delays.hi - 1.0).abs() > 0.1, "{estimated:?} {of_delays:?}");
        assert_eq!(estimated.method.remark(), Some("from half widths"));
        // Most lower ends are zero, so that the upper end of the throughput is infinite.
        let cut: Vec<Delay> = delays.iter().map(|(value, _, hi)| (*value, 0.0, *hi)).collect();
        let [of_delays, of_throughputs] = assert_equal(&cut, sizes);
        assert_eq!((of_delays.lo, of_throughputs.hi), (0.0, f64::INFINITY));
    }

    #[test]
    fn negative_delays_have_interval_of_file() {
        let observed = |number| {
            let value = -0.3e-3 + 0.05e-3 * scattered(number);
            (value, value - 0.5e-3, value + 0.4e-3)
        };
        let delays: Vec<Delay> = (0..301).map(observed).collect();
        let file = median_bounds(delays.iter().map(|(_, lo, hi)| Some((*lo, *hi)))).expect("bounds");
        let (_, [page, _]) = intervals(&delays, |_| 8.0);
        assert!(
            (page.lo / file.0 - 1.0).abs() < 0.01 && (page.hi / file.1 - 1.0).abs() < 0.01,
            "{file:?} {page:?}"
        );
        assert!(page.lo < -0.7e-3);
        assert_eq!(ClockInterval::from_half_width(-0.25, 0.5).ends(), (-0.75, 0.25));
        assert_eq!(ClockInterval::from_half_width(1.0, 4.0).ends(), (0.0, 5.0));
    }

    #[test]
    fn median_has_no_interval_unless_every_delay_has_bounds() {
        assert_eq!(
            [median_bounds([Some((0.0, 1.0)), None].into_iter()), median_bounds(std::iter::empty())],
            [None, None]
        );
        let (delays, of_some) = (summary([1e-3; 40].into_iter()), summary([1e-4; 39].into_iter()));
        let ends = [of_some.clone(), of_some.clone()];
        let some = ClockedSummaries {
            values: &delays,
            ends: Some(&ends),
            delays: &delays,
            half_widths: Some(&of_some),
        };
        assert_eq!((some.interval_of_median_delay(), some.interval_of_median_throughput()), (None, None));
        // The first part of the run was stored by an earlier version.
        let all = ClockedSummaries { half_widths: Some(&delays), ..some };
        let methods = [all.interval_of_median_delay(), all.interval_of_median_throughput()];
        assert_eq!(methods.map(|one| one.map(|one| one.method)), [Some(IntervalMethod::HalfWidths); 2]);
    }
}
