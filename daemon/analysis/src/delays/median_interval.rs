//! Interval that the clock bounds give for the median of delays or throughputs, from single values or from stored
//! statistics.

use peernet_statistics::Summary;

use crate::order::SortedValues;

/// Returns the median of the lower bounds and the median of the upper bounds of all values. If each true value lies
/// between its bounds, the median of the true values lies between these medians. `None` unless every value has bounds:
/// a value without bounds may be anywhere, and so may the median.
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
    /// Median or mean of the values, in the SI unit.
    pub value: f64,
}

impl CountedAverage {
    /// Returns the number of values of a summary and their median, within 1 %; `None` without values.
    fn median_of(summary: &Summary) -> Option<Self> {
        Some(Self { count: summary.count(), value: summary.quantile(0.5)? })
    }
}

/// Method that computed the interval of a median or mean from stored statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalMethod {
    /// From the lower and the upper ends of all intervals. [`median_bounds`] does the same with single values.
    Ends,
    /// From half the widths of all intervals, because an earlier version recorded no ends. The result differs from
    /// [`median_bounds`] if the values do not lie in the middle of their intervals, or if the intervals are not equally
    /// wide.
    HalfWidths,
}

impl IntervalMethod {
    /// Returns the remark that is shown with an interval whose ends are estimated; `None` for the exact method.
    pub const fn remark(self) -> Option<&'static str> {
        match self {
            Self::Ends => None,
            Self::HalfWidths => Some("from half widths"),
        }
    }
}

/// Interval that the clock bounds give for the median or mean of a delay or throughput.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockInterval {
    /// Lower end.
    pub lo: f64,
    /// Upper end; infinite for a throughput whose delay may be zero.
    pub hi: f64,
    /// Method that computed the ends.
    pub method: IntervalMethod,
}

impl ClockInterval {
    /// Returns the interval of the median of single values ([`median_bounds`]); `None` unless every value has bounds.
    pub fn of_median(bounds: impl Iterator<Item = Option<(f64, f64)>>) -> Option<Self> {
        median_bounds(bounds).map(|(lo, hi)| Self { lo, hi, method: IntervalMethod::Ends })
    }

    /// Returns both ends.
    pub const fn ends(&self) -> (f64, f64) {
        (self.lo, self.hi)
    }

    /// Converts the interval of a delay into the interval of a throughput. The amount of data that `throughput`
    /// transfers in `delay` seconds is divided by the ends of the delay's interval.
    #[must_use]
    pub fn throughput_interval(&self, throughput: f64, delay: f64) -> Self {
        let amount = throughput * delay;
        let throughput_for = |seconds: f64| if seconds > 0.0 { amount / seconds } else { f64::INFINITY };
        Self { lo: throughput_for(self.hi), hi: throughput_for(self.lo), method: self.method }
    }

    /// Returns the interval from an average and half the width. If the average is not negative, the
    /// lower end is at least 0, because messages never arrive before they were sent. The average
    /// can be negative only in an observed system, where a delay is the difference between the
    /// times at which two receivers got one message.
    fn from_half_width(average: f64, half_width: f64) -> Self {
        let lo = average - half_width;
        let lo = if average < 0.0 { lo } else { lo.max(0.0) };
        Self { lo, hi: average + half_width, method: IntervalMethod::HalfWidths }
    }
}

/// Medians or means from the stored statistics of delays, seconds.
#[derive(Clone, Copy, Debug)]
pub struct DelayAverages {
    /// Median or mean of the delays.
    pub delay: CountedAverage,
    /// Medians or means of the lower ends and of the upper ends of the delays' intervals; `None` if the ends are not
    /// stored.
    pub ends: Option<[CountedAverage; 2]>,
    /// Median or mean of half the widths of the delays' intervals; `None` if no delay has an interval.
    pub half_width: Option<CountedAverage>,
}

impl DelayAverages {
    /// Returns the interval of the median or mean delay. `None` unless every delay has an interval, as for
    /// [`median_bounds`].
    ///
    /// No delay is below the lower end of its interval, so the median (or mean) of the delays is not below the median
    /// (or mean) of the lower ends. Likewise, the median (or mean) of the delays is not above that of the upper ends.
    pub fn interval(&self) -> Option<ClockInterval> {
        // A delay without an interval may be anywhere, and so may the median.
        let is_complete = |average: &CountedAverage| average.count >= self.delay.count;
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
    /// Lower and upper ends of the intervals of `values`, without infinite ends; `None` if the ends are not stored.
    pub ends: Option<&'a [Summary; 2]>,
    /// Delays, seconds.
    pub delays: &'a Summary,
    /// Half the widths of the intervals of the delays, seconds; `None` if no delay has an interval.
    pub half_widths: Option<&'a Summary>,
}

impl ClockedSummaries<'_> {
    /// Returns the interval of the median delay; `values` must be the delays themselves. `None` unless every delay has
    /// an interval, as for [`median_bounds`].
    pub fn interval_of_median_delay(&self) -> Option<ClockInterval> {
        self.delay_medians()?.interval()
    }

    /// Returns the interval of the median throughput. `None` unless every delay has an interval.
    ///
    /// If the ends are not stored, they are computed from the interval of the median delay
    /// ([`ClockInterval::throughput_interval`]). They then equal the ends of [`median_bounds`] only if all messages
    /// have about the same size and the conditions of [`IntervalMethod::HalfWidths`] hold.
    pub fn interval_of_median_throughput(&self) -> Option<ClockInterval> {
        self.interval_from_throughput_ends().or_else(|| {
            // `self.ends` are the ends of throughputs here, not of delays, so only the half widths of the delays can be
            // used.
            let medians = DelayAverages { ends: None, ..self.delay_medians()? };
            let interval = medians.interval()?;
            Some(interval.throughput_interval(self.values.quantile(0.5)?, medians.delay.value))
        })
    }

    /// Returns the medians of the delays. The `ends` of the result are ends of delays only if `values` are the delays.
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
        // The lower end of a throughput is always finite, so the number of lower ends is the number of intervals.
        (count > 0 && count >= self.values.count()).then_some(())?;
        let hi = median_upper_end(upper, count);
        Some(ClockInterval { lo: lower.quantile(0.5)?, hi, method: IntervalMethod::Ends })
    }
}

/// Returns the median of `count` upper ends. `finite_ends` is the summary of the finite ends; all other ends are
/// infinite.
fn median_upper_end(finite_ends: &Summary, count: u64) -> f64 {
    let (rank, last_finite_rank) = ((count - 1) as f64 / 2.0, finite_ends.count() as f64 - 1.0);
    // In ascending order, the infinite ends come after all finite ends.
    if rank > last_finite_rank {
        return f64::INFINITY;
    }
    let share = if last_finite_rank > 0.0 { rank / last_finite_rank } else { 0.0 };
    finite_ends.quantile(share).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests;
