//! Delay of messages against their size, in one direction of a link: the statistics of each size, and the line through
//! the medians.
//!
//! A calibration, the payload study of recorded runs and the page that compares runs all use this module, so that they
//! show equal numbers for equal messages.

use peernet_statistics::{Sketch, Summary};
use serde::Serialize;

use crate::delays::{ClockedSummaries, IntervalMethod, median_bounds};
use crate::fit::{Fit, Point, WeightedPoint, least_squares};
use crate::order::{SortedValues, Z95, ranks_around_median};

/// Resolution of a clock, a tenth of a microsecond. The error of a median is not smaller.
const CLOCK_RESOLUTION_S: f64 = 1e-7;

/// Message whose delay is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Message {
    /// Size of payload and metadata together, bytes.
    pub wire_bytes: f64,
    /// One-way delay, seconds.
    pub delay: f64,
    /// Clock bounds of the delay, seconds; `None` if they are not known.
    pub bounds: Option<(f64, f64)>,
}

/// Statistics of a run's messages in one direction, as they are stored. Sketches do not say which delay belongs to
/// which size, so all messages of a run count as messages of one size.
#[derive(Clone, Copy, Debug)]
pub struct MessageSketches<'a> {
    /// Sizes of the payloads, bytes.
    pub payload: &'a Summary,
    /// Sizes of the metadata, bytes; `None` if the messages have no metadata.
    pub metadata: Option<&'a Summary>,
    /// Known one-way delays, seconds; `None` if no delay is known.
    pub delay: Option<&'a Summary>,
    /// Half the widths of the clock bounds of the delays, seconds; `None` if no delay has bounds.
    pub half_width: Option<&'a Summary>,
    /// Lower and upper ends of the clock bounds of the delays, seconds; `None` if they are not stored.
    pub ends: Option<&'a [Summary; 2]>,
}

/// Summary of the messages of one size. The units are seconds, bytes and bits per second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeSummary {
    /// Size of the payload.
    pub payload_bytes: u64,
    /// Median size of a message, payload and metadata together.
    pub wire_bytes: f64,
    /// Number of known delays.
    pub count: u64,
    /// Median delay.
    pub median: f64,
    /// Largest relative error of the medians and percentiles: 0 from single values, [`Sketch::RELATIVE_ERROR`] from
    /// sketches.
    #[serde(skip)]
    pub relative_error: f64,
    /// Standard error of the median; `None` with fewer than six values. For a median from sketches, the error of the
    /// sketch is included.
    pub median_error: Option<f64>,
    /// 5th and 95th percentile; `None` with fewer than 60 values.
    pub tails: Option<(f64, f64)>,
    /// Median of the lower clock bounds and median of the upper clock bounds; `None` unless every delay has bounds.
    pub bounds: Option<(f64, f64)>,
    /// Method by which `bounds` were computed.
    #[serde(skip)]
    pub bounds_method: IntervalMethod,
    /// Size divided by the median delay; `None` if the median delay is not above zero.
    pub throughput: Option<f64>,
    /// Size divided by the upper bound of the delay, and size divided by the lower bound. The second value is `None` if
    /// the lower bound is zero.
    pub throughput_bounds: Option<(f64, Option<f64>)>,
}

impl SizeSummary {
    /// Returns the summary of messages of one size; `None` without messages.
    pub fn new(payload_bytes: u64, messages: &[Message]) -> Option<Self> {
        let sorted = |value: fn(&Message) -> f64| messages.iter().map(value).collect::<SortedValues>();
        let wire_bytes = sorted(|message| message.wire_bytes).median()?;
        let delays = sorted(|message| message.delay);
        let median = delays.median()?;
        let bounds = median_bounds(messages.iter().map(|message| message.bounds));
        let size = Self {
            payload_bytes,
            wire_bytes,
            count: delays.len() as u64,
            median,
            relative_error: 0.0,
            median_error: delays.median_error(),
            tails: delays.tails(),
            bounds,
            bounds_method: IntervalMethod::Ends,
            throughput: None,
            throughput_bounds: None,
        };
        Some(size.with_throughput())
    }

    /// Returns the summary of the messages of all these runs, which count as messages of one size. `None` without a
    /// known delay.
    pub fn from_sketches(payload_bytes: u64, runs: &[MessageSketches<'_>]) -> Option<Self> {
        let mut merged = [(); 4].map(|()| Summary::default());
        for run in runs {
            let quantities = [Some(run.payload), run.metadata, run.delay, run.half_width];
            merged
                .iter_mut()
                .zip(quantities)
                .for_each(|(all, one)| one.iter().for_each(|one| all.merge(one)));
        }
        let [payload, metadata, delay, half_width] = merged;
        // If a run has no stored ends, there are fewer ends than delays. The bounds then follow from the half widths.
        let mut ends: [Summary; 2] = Default::default();
        for stored in runs.iter().filter_map(|run| run.ends) {
            ends.iter_mut().zip(stored).for_each(|(all, one)| all.merge(one));
        }
        let median = delay.quantile(0.5)?;
        let relative_error = Sketch::RELATIVE_ERROR;
        let median_error = ranks_around_median(delay.count()).and_then(|[lower, upper]| {
            let at = |rank: u64| delay.quantile((rank - 1) as f64 / (delay.count() - 1) as f64);
            let sampling_error = (at(upper)? - at(lower)?) / (2.0 * Z95);
            // The error of the sketch counts as uniformly distributed between ±e, which has the standard deviation e /
            // √3.
            Some(sampling_error.hypot(relative_error * median / 3.0_f64.sqrt()))
        });
        let clocked = ClockedSummaries {
            values: &delay,
            ends: Some(&ends),
            delays: &delay,
            half_widths: Some(&half_width),
        };
        let interval = clocked.interval_of_median_delay();
        let size = Self {
            payload_bytes,
            wire_bytes: payload.quantile(0.5)? + metadata.quantile(0.5).unwrap_or_default(),
            count: delay.count(),
            median,
            relative_error,
            median_error,
            tails: delay.tails(),
            bounds: interval.map(|interval| interval.ends()),
            bounds_method: interval.map_or(IntervalMethod::Ends, |interval| interval.method),
            throughput: None,
            throughput_bounds: None,
        };
        Some(size.with_throughput())
    }

    /// Adds the throughput, which follows from the size, the median delay and its bounds.
    fn with_throughput(self) -> Self {
        let rate = |seconds: f64| (seconds > 0.0).then(|| self.wire_bytes * 8.0 / seconds);
        Self {
            throughput: rate(self.median),
            // The upper bound of the delay gives the lower bound of the throughput. If the lower bound of the delay is
            // zero or less, the throughput has no upper bound.
            throughput_bounds: self.bounds.and_then(|(lo, hi)| Some((rate(hi)?, rate(lo)))),
            ..self
        }
    }

    /// Returns the point of the size in a chart: the median size on the x axis, the median delay on the y axis.
    pub fn point(&self) -> Point {
        Point { x: self.wire_bytes, y: self.median }
    }
}

/// Fits a line of seconds over bytes through the medians by least squares. Each median is weighted by its precision. If
/// one size has so few messages that the precision of its median is unknown, all sizes have the same weight. `None`
/// with fewer than three sizes.
pub fn line_through_medians(sizes: &[SizeSummary]) -> Option<Fit> {
    let errors: Option<Vec<f64>> = sizes.iter().map(|size| size.median_error).collect();
    let weight =
        |index: usize| errors.as_ref().map_or(1.0, |errors| errors[index].max(CLOCK_RESOLUTION_S).powi(-2));
    let weighted = sizes
        .iter()
        .enumerate()
        .map(|(index, size)| WeightedPoint { point: size.point(), weight: weight(index) });
    least_squares(&weighted.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(wire_bytes: f64, delay: f64, bounds: Option<(f64, f64)>) -> Message {
        Message { wire_bytes, delay, bounds }
    }

    #[test]
    fn size_has_no_bounds_if_one_delay_has_none() {
        let bounded = message(100.0, 1e-3, Some((0.5e-3, 1.5e-3)));
        let size = SizeSummary::new(90, &[bounded, bounded]).expect("messages");
        assert_eq!((size.bounds, size.count, size.wire_bytes), (Some((0.5e-3, 1.5e-3)), 2, 100.0));
        assert_eq!(
            size.throughput_bounds.map(|(lo, hi)| (lo.round(), hi.map(f64::round))),
            Some((533_333.0, Some(1_600_000.0)))
        );
        // The other delay may be anywhere, and so may the median.
        let size = SizeSummary::new(90, &[bounded, message(100.0, 9e-3, None)]).expect("messages");
        assert_eq!((size.bounds, size.throughput_bounds), (None, None));
        assert_eq!(SizeSummary::new(90, &[]), None);
    }

    #[test]
    fn size_from_sketches_is_within_their_error() {
        let delays = (0..200).map(|number| 4e-3 + f64::from(number * 37 % 200) * 1e-5);
        // The delays are not in the middle of their bounds, which are not equally wide.
        let bounds = |delay: f64| (delay - 0.1e-3, delay + 0.2 * (delay - 3.9e-3) + 0.4e-3);
        let messages: Vec<Message> =
            delays.map(|delay| message(1_120.0, delay, Some(bounds(delay)))).collect();
        let exact = SizeSummary::new(1_000, &messages).expect("messages");
        let summary = |values: &dyn Fn(&Message) -> f64| {
            let mut all = Summary::default();
            messages.iter().for_each(|message| all.record(values(message)));
            all
        };
        let [payload, metadata] = [1_000.0, 120.0].map(|size| summary(&|_| size));
        let of_bounds =
            |of: fn((f64, f64)) -> f64| summary(&|message| of(message.bounds.expect("has bounds")));
        let (delay, half_width) = (summary(&|message| message.delay), of_bounds(|(lo, hi)| (hi - lo) / 2.0));
        let ends = [of_bounds(|(lo, _)| lo), of_bounds(|(_, hi)| hi)];
        let run = MessageSketches {
            payload: &payload,
            metadata: Some(&metadata),
            delay: Some(&delay),
            half_width: Some(&half_width),
            ends: Some(&ends),
        };
        let stored = SizeSummary::from_sketches(1_000, &[run]).expect("delays");
        assert_eq!((stored.count, stored.wire_bytes, stored.relative_error), (200, 1_120.0, 0.01));
        let numbers = |size: &SizeSummary| {
            let (tails, bounds) = (size.tails.expect("enough"), size.bounds.expect("all have bounds"));
            [size.median, tails.0, tails.1, bounds.0, bounds.1, size.throughput.expect("a median")]
        };
        for (stored, exact) in numbers(&stored).into_iter().zip(numbers(&exact)) {
            assert!((stored / exact - 1.0).abs() < 0.011, "{stored} {exact}");
        }
        let error = |size: &SizeSummary| size.median_error.expect("enough");
        // The error from sketches includes the error of the sketch, which is 1 % / √3 of the
        // median.
        assert!(error(&stored) >= 0.01 * stored.median / 2.0 && error(&stored) < 3.0 * error(&exact));
        // Some delays have no bounds.
        let unbounded = MessageSketches { half_width: None, ends: None, ..run };
        let two = SizeSummary::from_sketches(1_000, &[run, unbounded]).expect("delays");
        assert_eq!((two.count, two.bounds), (400, None));
        // An earlier version, which recorded no ends, stored one of the runs.
        let earlier = MessageSketches { ends: None, ..run };
        let methods = [vec![run], vec![run, earlier]]
            .map(|runs| SizeSummary::from_sketches(1_000, &runs).expect("delays").bounds_method);
        assert_eq!(methods, [IntervalMethod::Ends, IntervalMethod::HalfWidths]);
        assert_eq!(SizeSummary::from_sketches(1_000, &[MessageSketches { delay: None, ..run }]), None);
    }

    #[test]
    fn imprecise_median_hardly_affects_line() {
        let size = |bytes: f64, delay: f64, scatter: f64| {
            let messages: Vec<Message> = (0..50)
                .map(|number| message(bytes, delay + scatter * f64::from(number % 5 - 2), None))
                .collect();
            SizeSummary::new(bytes as u64, &messages).expect("messages")
        };
        let sizes =
            [size(1e3, 1e-3, 1e-6), size(2e3, 2e-3, 1e-6), size(3e3, 3e-3, 1e-6), size(4e3, 9e-3, 1e-2)];
        let fit = line_through_medians(&sizes).expect("four sizes");
        assert!((fit.slope.value * 1e6 - 1.0).abs() < 0.01, "{fit:?}");
        assert_eq!(line_through_medians(&sizes[..2]), None);
    }
}
