//! Delay of messages against their size, in one direction of a link: the statistics of each size, and the line through the medians.
//!
//! A calibration and the payload study of recorded runs both use them, so that both give equal numbers for equal messages.

use serde::Serialize;

use crate::delays::median_bounds;
use crate::fit::{Fit, Point, Weighted, least_squares};
use crate::order::SortedValues;

/// Resolution of a clock, a tenth of a microsecond: the minimum error of a median.
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

/// Summary of the messages of one size. Seconds, bytes, bits per second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeSummary {
    /// Size of the payload.
    pub payload_bytes: u64,
    /// Median size of payload and metadata together.
    pub wire_bytes: f64,
    /// Number of known delays.
    pub count: u64,
    /// Median delay.
    pub median: f64,
    /// Standard error of the median; `None` with fewer than six values.
    pub median_error: Option<f64>,
    /// 5th and 95th percentile; `None` with fewer than 60 values.
    pub tails: Option<(f64, f64)>,
    /// Median of the lower clock bounds and median of the upper clock bounds; `None` unless every delay has bounds.
    pub bounds: Option<(f64, f64)>,
    /// Size divided by the median delay; `None` if the median delay is not above zero.
    pub throughput: Option<f64>,
    /// Size divided by the upper bound of the delay, and size divided by the lower bound. The second value is `None` if the lower bound is zero.
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
        let rate = |seconds: f64| (seconds > 0.0).then(|| wire_bytes * 8.0 / seconds);
        Some(Self {
            payload_bytes,
            wire_bytes,
            count: delays.len() as u64,
            median,
            median_error: delays.median_error(),
            tails: delays.tails(),
            bounds,
            throughput: rate(median),
            // The longest delay gives the lowest throughput. If the shortest is zero or less, the throughput has no upper bound.
            throughput_bounds: bounds.and_then(|(lo, hi)| Some((rate(hi)?, rate(lo)))),
        })
    }

    /// Returns the median delay over the median size.
    pub fn point(&self) -> Point {
        Point { x: self.wire_bytes, y: self.median }
    }
}

/// Fits a line of seconds over bytes through the medians by least squares. Each median is weighted by its precision. If one size has so few
/// messages that the precision of its median is unknown, all sizes have the same weight. `None` with fewer than three sizes.
pub fn line_through_medians(sizes: &[SizeSummary]) -> Option<Fit> {
    let errors: Option<Vec<f64>> = sizes.iter().map(|size| size.median_error).collect();
    let weight =
        |index: usize| errors.as_ref().map_or(1.0, |errors| errors[index].max(CLOCK_RESOLUTION_S).powi(-2));
    let weighted =
        sizes.iter().enumerate().map(|(index, size)| Weighted { point: size.point(), weight: weight(index) });
    least_squares(&weighted.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(wire_bytes: f64, delay: f64, bounds: Option<(f64, f64)>) -> Message {
        Message { wire_bytes, delay, bounds }
    }

    #[test]
    fn size_without_bounds_of_every_delay_has_none() {
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
    fn precise_medians_determine_line() {
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
