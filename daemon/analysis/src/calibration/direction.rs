//! Statistics of one direction of the link.

use std::collections::{BTreeMap, BTreeSet};

use peernet_clock::{DelaySource, Direction};
use serde::Serialize;

use super::passage::Passage;
use super::sample::Sample;
use crate::delays::VerdictCounts;
use crate::fit::{Estimate, Fit, Point, SlopeRate, WeightedPoint, least_squares, rate_range, theil_sen};
use crate::message_sizes::{Message, SizeSummary, line_through_medians};
use crate::order::Z95;
use crate::transfer::DirectionNodes;

/// Statistics of one direction of the link.
#[derive(Clone, Debug, Serialize)]
pub struct DirectionStudy {
    /// Direction of the messages.
    pub direction: Direction,
    /// Summary of each size, smallest first.
    pub sizes: Vec<SizeSummary>,
    /// Fits of delay against bytes; `None` with fewer than three sizes.
    pub fits: Option<Fits>,
    /// Bounds that the clock relation gives for the smallest payload; `None` if not every delay of this payload has
    /// bounds.
    #[serde(rename = "claimed")]
    pub allowed: Option<AllowedDelays>,
    /// Throughput that follows from the slope of the main fit; `None` without fits, or if delays do not grow with size.
    pub throughput: Option<Throughput>,
    /// Number of delays for each verdict that occurs.
    pub verdicts: BTreeMap<&'static str, u64>,
    /// True if both hosts read the same clock, so that the delays have no clock error.
    pub same_clock: bool,
}

/// Fits of the delay in seconds against the bytes on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fits {
    /// Fits to the medians of the sizes. The fit by least squares, which is weighted by the precision of each median,
    /// is the main fit: the verdict depends on it.
    pub medians: FitPair,
    /// Fits to every sample.
    pub samples: FitPair,
    /// Fit by least squares to the raw differences of the stamps of every sample, as in the paper.
    pub raw: Fit,
}

/// Two fits to one set of points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FitPair {
    /// Fit by least squares.
    pub least_squares: Fit,
    /// Fit by Theil and Sen.
    pub theil_sen: Fit,
}

/// Bounds that the clock relation gives for the delay of the smallest payload, and the bounds for an empty message that
/// follow from these bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AllowedDelays {
    /// Smallest payload, bytes.
    pub payload_bytes: u64,
    /// Bounds of the delay of the smallest payload, seconds: median of the lower bounds and median of the upper bounds.
    pub bounds: (f64, f64),
    /// Bounds of the delay of an empty message, seconds. They are the bounds of the smallest payload, minus the time that the bytes of
    /// this payload take according to the slope. Both ends are moved outwards by the 95 % margin of the median delay, because the median is
    /// an estimate, too. The bounds are never negative.
    pub at_zero: (f64, f64),
}

/// Throughput that follows from the slope of a fit, bits per second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Throughput {
    /// Reciprocal of the slope.
    pub value: f64,
    /// Reciprocals of the ends of the slope's confidence interval. The upper end is `None` if the confidence interval reaches zero.
    pub interval: Option<(f64, Option<f64>)>,
    /// Range of the throughput if the delays can lie anywhere within their clock bounds. The range is computed from the
    /// flattest and the steepest line between the smallest and the largest size. The range is wider than necessary: it
    /// treats the clock errors of both sizes as independent, but a constant error of the clocks does not change the
    /// slope.
    /// `None` if the bounds are not known.
    pub bounds: Option<(f64, Option<f64>)>,
}

impl DirectionStudy {
    /// Returns the statistics of one direction from the samples in the statistics.
    pub(super) fn new(direction: Direction, samples: &[Sample]) -> Self {
        let passages = passages_in_statistics(direction, samples);
        let verdicts: VerdictCounts = passages.iter().map(|(_, passage)| passage.delay.verdict).collect();
        let payloads: BTreeSet<u64> = passages.iter().map(|(payload, _)| *payload).collect();
        let sizes: Vec<SizeSummary> =
            payloads.iter().filter_map(|payload| size_summary(*payload, &passages)).collect();
        let fits = Fits::new(&sizes, &passages);
        let main_fit = fits.as_ref().map(|fits| fits.medians.least_squares);
        let same_clock = !passages.is_empty()
            && passages.iter().all(|(_, passage)| passage.delay.source == DelaySource::SameClock);
        Self {
            direction,
            allowed: sizes.first().and_then(|smallest| AllowedDelays::new(smallest, main_fit.as_ref())),
            throughput: main_fit.and_then(|fit| Throughput::with_bounds(fit.slope, &sizes)),
            sizes,
            fits,
            verdicts: verdicts.counts().map(|(verdict, count)| (verdict.name(), count)).collect(),
            same_clock,
        }
    }

    /// Returns the fit that the verdict depends on.
    pub fn main_fit(&self) -> Option<&Fit> {
        self.fits.as_ref().map(|fits| &fits.medians.least_squares)
    }

    /// Returns the name of the stage that the messages of this direction belong to.
    pub fn name(&self) -> &'static str {
        DirectionNodes::of(self.direction).delay.as_str()
    }

    /// Returns the number of delays that have any of these verdicts.
    pub(super) fn count_verdicts(&self, verdicts: &[peernet_clock::Verdict]) -> u64 {
        verdicts.iter().filter_map(|verdict| self.verdicts.get(verdict.name())).sum()
    }
}

/// Returns the median delay of the messages with this payload in the statistics, seconds, computed as in
/// [`DirectionStudy`]. `None` if no delay of these messages is known.
pub fn median_delay(direction: Direction, samples: &[Sample], payload_bytes: u64) -> Option<f64> {
    size_summary(payload_bytes, &passages_in_statistics(direction, samples)).map(|size| size.median)
}

/// Returns the payload in bytes and the message of each sample in the statistics that has a message in this
/// direction.
fn passages_in_statistics(direction: Direction, samples: &[Sample]) -> Vec<(u64, &Passage)> {
    let in_statistics = samples.iter().filter(|sample| sample.is_in_statistics());
    in_statistics.filter_map(|sample| Some((sample.payload_bytes, sample.passage(direction)?))).collect()
}

/// Returns the summary of all messages with this payload; `None` if no delay of these messages is known.
fn size_summary(payload_bytes: u64, passages: &[(u64, &Passage)]) -> Option<SizeSummary> {
    let message = |passage: &Passage| {
        let delay = passage.delay.known_seconds()?;
        Some(Message { wire_bytes: passage.wire_bytes() as f64, delay, bounds: passage.delay.known_bounds() })
    };
    let with_payload = passages.iter().filter(|(payload, _)| *payload == payload_bytes);
    let messages: Vec<Message> = with_payload.filter_map(|(_, passage)| message(passage)).collect();
    SizeSummary::new(payload_bytes, &messages)
}

impl Fits {
    fn new(sizes: &[SizeSummary], passages: &[(u64, &Passage)]) -> Option<Self> {
        let medians: Vec<Point> = sizes.iter().map(SizeSummary::point).collect();
        let points = |delay: &dyn Fn(&Passage) -> Option<f64>| -> Vec<Point> {
            let point =
                |passage: &Passage| Some(Point { x: passage.wire_bytes() as f64, y: delay(passage)? });
            passages.iter().filter_map(|(_, passage)| point(passage)).collect()
        };
        let unweighted = |points: &[Point]| {
            least_squares(&points.iter().copied().map(WeightedPoint::from).collect::<Vec<_>>())
        };
        let samples = points(&|passage| passage.delay.known_seconds());
        Some(Self {
            medians: FitPair { least_squares: line_through_medians(sizes)?, theil_sen: theil_sen(&medians)? },
            samples: FitPair { least_squares: unweighted(&samples)?, theil_sen: theil_sen(&samples)? },
            raw: unweighted(&points(&|passage| Some(passage.delay.raw.seconds())))?,
        })
    }
}

impl AllowedDelays {
    fn new(smallest: &SizeSummary, fit: Option<&Fit>) -> Option<Self> {
        let (lo, hi) = smallest.bounds?;
        // A negative slope is noise. It must not raise the bounds of an empty message above those of the payload.
        let payload_time = fit.map_or(0.0, |fit| fit.slope.value * smallest.wire_bytes).max(0.0);
        let margin = smallest.median_error.map_or(0.0, |error| Z95 * error);
        let at_zero = ((lo - payload_time - margin).max(0.0), (hi - payload_time + margin).max(0.0));
        Some(Self { payload_bytes: smallest.payload_bytes, bounds: (lo, hi), at_zero })
    }
}

impl Throughput {
    /// Returns the throughput of a slope in seconds per byte; `None` when delays do not grow with size.
    pub(super) fn from_slope(slope: Estimate) -> Option<Self> {
        SlopeRate::new(slope).map(|SlopeRate { value, interval }| Self { value, interval, bounds: None })
    }

    /// Returns the throughput of a slope, with its range within the clock bounds. `sizes` begins with the smallest
    /// size.
    fn with_bounds(slope: Estimate, sizes: &[SizeSummary]) -> Option<Self> {
        let (first, last) = (sizes.first()?, sizes.last()?);
        let bytes = last.wire_bytes - first.wire_bytes;
        let slopes = first.bounds.zip(last.bounds).map(|((first_lo, first_hi), (last_lo, last_hi))| {
            // The flattest line goes from the highest possible delay of the smallest size to the lowest possible delay
            // of the largest size. The steepest line goes from the lowest to the highest possible delay.
            ((last_lo - first_hi) / bytes, (last_hi - first_lo) / bytes)
        });
        Some(Self { bounds: slopes.and_then(rate_range), ..Self::from_slope(slope)? })
    }
}
