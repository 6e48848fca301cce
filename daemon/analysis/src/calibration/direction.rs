//! Statistics of one direction of the link.

use std::collections::{BTreeMap, BTreeSet};

use peernet_clock::{DelaySource, Direction};
use serde::Serialize;

use super::sample::Sample;
use crate::Passage;
use crate::fit::{Estimate, Fit, Point, Weighted, least_squares, theil_sen};
use crate::order::{SortedValues, Z95};

/// Resolution of a clock, a tenth of a microsecond: the minimum error of a median.
const CLOCK_RESOLUTION_S: f64 = 1e-7;

/// Statistics of one direction of the link.
#[derive(Clone, Debug, Serialize)]
pub struct DirectionStudy {
    /// Direction of the messages.
    pub direction: Direction,
    /// Summary of each size, smallest first.
    pub sizes: Vec<SizeSummary>,
    /// Fits of delay against bytes; `None` with fewer than three sizes.
    pub fits: Option<Fits>,
    /// Bounds that the clock relation gives for the smallest payload.
    pub claimed: Option<Claim>,
    /// Throughput that the slope implies.
    pub throughput: Option<Throughput>,
    /// Number of delays by verdict.
    pub verdicts: BTreeMap<&'static str, u64>,
    /// `true` if both ends read one clock.
    pub same_clock: bool,
}

/// All messages of one size. Seconds, bytes, bits per second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeSummary {
    /// Payload.
    pub payload_bytes: u64,
    /// Payload and metadata, median.
    pub wire_bytes: f64,
    /// Number of values.
    pub count: u64,
    /// Median delay.
    pub median: f64,
    /// Standard error of the median; `None` with fewer than six values.
    pub median_error: Option<f64>,
    /// 5th and 95th percentile; `None` with fewer than 60.
    pub tails: Option<(f64, f64)>,
    /// Median of the lower and of the upper clock bounds.
    pub bounds: Option<(f64, f64)>,
    /// Bytes divided by the median delay; `None` when that is zero.
    pub throughput: Option<f64>,
    /// Bytes divided by the upper and by the lower bound of the delay; the second value is `None` if the lower bound is zero.
    pub throughput_bounds: Option<(f64, Option<f64>)>,
}

/// Delay against bytes on the wire: seconds, seconds per byte.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fits {
    /// Fit to the medians of the sizes. Least squares are weighted by the precision of each median; the verdict depends on this fit.
    pub medians: FitPair,
    /// Fit to every sample.
    pub samples: FitPair,
    /// Least squares over every raw difference of stamps, as in the published study.
    pub raw: Fit,
}

/// Two fits to one set of points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FitPair {
    /// Fit by least squares.
    pub least_squares: Fit,
    /// Theil–Sen.
    pub theil_sen: Fit,
}

/// Bounds that the clock relation gives for the smallest payload, and the bounds that follow from them for an empty message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Claim {
    /// The smallest payload, bytes.
    pub payload_bytes: u64,
    /// Bounds of its delay, seconds: medians.
    pub bounds: (f64, f64),
    /// Bounds for an empty message: the bounds of the smallest payload minus the time that its bytes take by the slope. They are widened by
    /// the 95 % margin of the payload's median on both sides, because the median is an estimate, too. Never negative.
    pub at_zero: (f64, f64),
}

/// Throughput that the slope implies: bits per second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Throughput {
    /// Reciprocal of the slope.
    pub value: f64,
    /// Reciprocals of the slope's confidence interval; the upper end is `None` if the confidence interval reaches zero.
    pub interval: Option<(f64, Option<f64>)>,
    /// Range for delays anywhere within their clock bounds: the lines with the lowest and the highest slope from the smallest to the
    /// largest size. A constant error of the clocks cancels, so this range is wider than necessary.
    pub bounds: Option<(f64, Option<f64>)>,
}

impl DirectionStudy {
    /// Returns the statistics of one direction, of the samples that count.
    pub(super) fn new(direction: Direction, samples: &[Sample]) -> Self {
        let passages: Vec<(u64, &Passage)> = samples
            .iter()
            .filter(|sample| sample.is_counted())
            .filter_map(|sample| Some((sample.payload_bytes, sample.passage(direction)?)))
            .collect();
        let mut verdicts = BTreeMap::new();
        for (_, passage) in &passages {
            *verdicts.entry(passage.delay.verdict.name()).or_default() += 1;
        }
        let payloads: BTreeSet<u64> = passages.iter().map(|(payload, _)| *payload).collect();
        let sizes: Vec<SizeSummary> =
            payloads.iter().filter_map(|payload| SizeSummary::new(*payload, &passages)).collect();
        let fits = Fits::new(&sizes, &passages);
        let main = fits.as_ref().map(|fits| fits.medians.least_squares);
        let same_clock = !passages.is_empty()
            && passages.iter().all(|(_, passage)| passage.delay.source == DelaySource::SameClock);
        Self {
            direction,
            claimed: sizes.first().and_then(|smallest| Claim::new(smallest, main.as_ref())),
            throughput: main.and_then(|fit| Throughput::with_bounds(fit.slope, &sizes)),
            sizes,
            fits,
            verdicts,
            same_clock,
        }
    }

    /// Returns the fit that the verdict depends on.
    pub fn main_fit(&self) -> Option<&Fit> {
        self.fits.as_ref().map(|fits| &fits.medians.least_squares)
    }

    /// Returns the name of its stage.
    pub fn name(&self) -> &'static str {
        match self.direction {
            Direction::Up => "upload",
            Direction::Down => "download",
        }
    }

    /// Returns the number of delays that have any of these verdicts.
    pub(super) fn count_verdicts(&self, verdicts: &[peernet_clock::Verdict]) -> u64 {
        verdicts.iter().filter_map(|verdict| self.verdicts.get(verdict.name())).sum()
    }
}

impl SizeSummary {
    /// Returns the summary of all messages with this payload; `None` when no delay among them is known.
    fn new(payload_bytes: u64, passages: &[(u64, &Passage)]) -> Option<Self> {
        let of_this =
            || passages.iter().filter(|(payload, _)| *payload == payload_bytes).map(|(_, passage)| *passage);
        let known = || of_this().filter(|passage| passage.seconds().is_some());
        let delays: SortedValues = known().filter_map(Passage::seconds).collect();
        let bounds = || known().filter_map(Passage::bounds);
        let lo = bounds().map(|bounds| bounds.0).collect::<SortedValues>().median();
        let hi = bounds().map(|bounds| bounds.1).collect::<SortedValues>().median();
        let bounds = lo.zip(hi);
        let wire_bytes =
            known().map(|passage| passage.wire_bytes() as f64).collect::<SortedValues>().median()?;
        let median = delays.median()?;
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
            throughput_bounds: bounds.and_then(|(lo, hi)| Some((rate(hi)?, rate(lo)))),
        })
    }

    fn point(&self) -> Point {
        Point { x: self.wire_bytes, y: self.median }
    }
}

impl Fits {
    fn new(sizes: &[SizeSummary], passages: &[(u64, &Passage)]) -> Option<Self> {
        let medians: Vec<Point> = sizes.iter().map(SizeSummary::point).collect();
        // With few samples of a size the precision of its median is unknown: all sizes get the same weight.
        let errors: Option<Vec<f64>> = sizes.iter().map(|size| size.median_error).collect();
        let weight = |index: usize| {
            errors.as_ref().map_or(1.0, |errors| errors[index].max(CLOCK_RESOLUTION_S).powi(-2))
        };
        let weighted: Vec<Weighted> = medians
            .iter()
            .enumerate()
            .map(|(index, &point)| Weighted { point, weight: weight(index) })
            .collect();

        let points = |delay: &dyn Fn(&Passage) -> Option<f64>| -> Vec<Point> {
            let point =
                |passage: &Passage| Some(Point { x: passage.wire_bytes() as f64, y: delay(passage)? });
            passages.iter().filter_map(|(_, passage)| point(passage)).collect()
        };
        let unweighted =
            |points: &[Point]| least_squares(&points.iter().copied().map(Weighted::from).collect::<Vec<_>>());
        let samples = points(&Passage::seconds);
        Some(Self {
            medians: FitPair { least_squares: least_squares(&weighted)?, theil_sen: theil_sen(&medians)? },
            samples: FitPair { least_squares: unweighted(&samples)?, theil_sen: theil_sen(&samples)? },
            raw: unweighted(&points(&|passage| Some(passage.delay.raw.seconds())))?,
        })
    }
}

impl Claim {
    fn new(smallest: &SizeSummary, fit: Option<&Fit>) -> Option<Self> {
        let (lo, hi) = smallest.bounds?;
        // A negative slope is noise: it must not raise the bounds of an empty message above those of the payload.
        let bytes = fit.map_or(0.0, |fit| fit.slope.value * smallest.wire_bytes).max(0.0);
        let margin = smallest.median_error.map_or(0.0, |error| Z95 * error);
        let at_zero = ((lo - bytes - margin).max(0.0), (hi - bytes + margin).max(0.0));
        Some(Self { payload_bytes: smallest.payload_bytes, bounds: (lo, hi), at_zero })
    }
}

impl Throughput {
    /// Returns the throughput of a slope in seconds per byte; `None` when delays do not grow with size.
    pub(super) fn from_slope(slope: Estimate) -> Option<Self> {
        Some(Self { value: rate(slope.value)?, interval: slope.interval.and_then(rate_range), bounds: None })
    }

    fn with_bounds(slope: Estimate, sizes: &[SizeSummary]) -> Option<Self> {
        let (first, last) = (sizes.first()?, sizes.last()?);
        let bytes = last.wire_bytes - first.wire_bytes;
        let lines = first.bounds.zip(last.bounds).map(|((first_lo, first_hi), (last_lo, last_hi))| {
            ((last_lo - first_hi) / bytes, (last_hi - first_lo) / bytes)
        });
        Some(Self { bounds: lines.and_then(rate_range), ..Self::from_slope(slope)? })
    }
}

/// Returns the bits per second of a slope in seconds per byte; `None` unless it is above 0.
fn rate(slope: f64) -> Option<f64> {
    (slope > 0.0).then(|| 8.0 / slope)
}

/// Returns the lowest and the highest rate for slopes in this range; the highest is `None` if the lowest slope is not positive.
fn rate_range((low_slope, high_slope): (f64, f64)) -> Option<(f64, Option<f64>)> {
    Some((rate(high_slope)?, rate(low_slope)))
}
