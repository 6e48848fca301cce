//! Range and bins of a histogram, computed from single values or from a summary.

use crate::Summary;

/// Minimum number of bins, unless fewer are asked for.
const MIN_BINS: usize = 8;
/// Maximum number of bins that the rule of Freedman and Diaconis may give.
pub const MAX_BINS: usize = 60;
/// At most one value in this many may be cut off at each end of the axis.
const VALUES_PER_CUT: u64 = 100;
/// Number of values that may be cut off at each end even if [`VALUES_PER_CUT`] permits fewer.
// One in a hundred of few values would be none, but also a short run can have a few stalls.
const MIN_CUT: u64 = 3;
/// Limit of [`MIN_CUT`] for few values: it permits at most one value in this many to be cut off at each end. With fewer
/// than 24 values, these are fewer than three.
const VALUES_PER_MIN_CUT: u64 = 8;
/// Values are cut off only if they would widen the axis by at least this factor.
const MIN_GAIN: f64 = 1.5;
/// Distance of Tukey's far fence from the nearer quartile, as a multiple of the interquartile range.
const FAR_FENCE: f64 = 3.0;

/// Values in ascending order.
pub trait OrderedValues {
    /// Returns the number of values.
    fn count(&self) -> u64;

    /// Returns the value with this rank, from 0. `None` if there are fewer values.
    fn at(&self, rank: u64) -> Option<f64>;

    /// Returns the smallest and the largest value within these limits, limits included. `None` if there are no such
    /// values.
    fn ends_within(&self, limits: (f64, f64)) -> Option<(f64, f64)>;

    /// Returns the quantile at `p` from 0 to 1, by linear interpolation between neighbours (definition 7 of Hyndman and
    /// Fan 1996). `None` without values.
    fn interpolated_quantile(&self, p: f64) -> Option<f64> {
        let rank = p.clamp(0.0, 1.0) * self.count().checked_sub(1)? as f64;
        let (below, above) = (self.at(rank.floor() as u64)?, self.at(rank.ceil() as u64)?);
        // Two equal values may both be infinite. The difference of the two would then be NaN.
        Some(if below == above { below } else { below + (above - below) * rank.fract() })
    }
}

/// Values in ascending order, without NaN.
impl OrderedValues for [f64] {
    fn count(&self) -> u64 {
        self.len() as u64
    }

    fn at(&self, rank: u64) -> Option<f64> {
        self.get(usize::try_from(rank).ok()?).copied()
    }

    fn ends_within(&self, (bottom, top): (f64, f64)) -> Option<(f64, f64)> {
        let inside =
            &self[self.partition_point(|value| *value < bottom)..self.partition_point(|value| *value <= top)];
        Some((*inside.first()?, *inside.last()?))
    }
}

/// The values of a summary are known within 1 %. The ends of a range are the ends of bins of the sketch, so that no bin
/// is counted in part.
impl OrderedValues for Summary {
    fn count(&self) -> u64 {
        self.count()
    }

    fn at(&self, rank: u64) -> Option<f64> {
        let mut cumulative_count = 0;
        let value = self.sketch.bins().find_map(|(value, count)| {
            cumulative_count += count;
            (cumulative_count > rank).then_some(value)
        })?;
        Some(value.max(self.moments.min).min(self.moments.max))
    }

    fn ends_within(&self, (bottom, top): (f64, f64)) -> Option<(f64, f64)> {
        let (min, max) = (self.moments.min, self.moments.max);
        let is_inside = |value: f64| (bottom..=top).contains(&value.max(min).min(max));
        let mut inside = self.sketch.bin_ends().filter(|(_, value, _)| is_inside(*value));
        let (lower, _, first_upper) = inside.next()?;
        let upper = inside.last().map_or(first_upper, |(_, _, upper)| upper);
        Some((lower.max(min), upper.min(max)))
    }
}

/// Returns the range of the values that are shown on an axis: all values, except a tail that would compress the rest.
/// `None` without values.
///
/// A value is in such a tail if both conditions hold:
///
/// - It is beyond the far fence of Tukey (*Exploratory Data Analysis*, 1977), three interquartile ranges beyond the
///   quartile.
/// - It is beyond the range of the typical values by more than half the width of that range. The typical values are all
///   values except 1 % at each end. If there are fewer than 400 values, three at each end are not typical; if there are
///   fewer than 24 values, one in eight at each end.
pub fn shown_range<V: OrderedValues + ?Sized>(values: &V) -> Option<(f64, f64)> {
    let count = values.count();
    let all = (values.at(0)?, values.at(count.checked_sub(1)?)?);
    let min_cut = (count / VALUES_PER_MIN_CUT).min(MIN_CUT);
    let max_cut = (count / VALUES_PER_CUT).max(min_cut);
    // Ranks are used, because interpolated quantiles would depend on the value that is to be excluded.
    let (low, high) = (values.at(max_cut)?, values.at(count - 1 - max_cut)?);
    let width = high - low;
    // If all but a few values are equal, there is no width to compare with.
    if max_cut == 0 || width <= 0.0 || !width.is_finite() {
        return values.ends_within(all);
    }
    let (lower, upper) = (values.interpolated_quantile(0.25)?, values.interpolated_quantile(0.75)?);
    let fence = FAR_FENCE * (upper - lower);
    let top = (low + MIN_GAIN * width).max(upper + fence);
    let bottom = (high - MIN_GAIN * width).min(lower - fence);
    values.ends_within((bottom, top))
}

/// Bins of equal width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Binning {
    /// Range of the values that are shown.
    pub range: (f64, f64),
    /// Lower end of the first bin.
    pub from: f64,
    /// Width of a bin.
    pub width: f64,
    /// Number of bins.
    pub count: usize,
}

impl Binning {
    /// Divides the [shown range](shown_range) of these values into bins. Their width is that of Freedman and Diaconis
    /// (1981): twice the interquartile range, divided by the cube root of the number of values. There are between 8 and
    /// 60 bins, but at most `max_bins`. If all values are equal, there is a single bin. `None` without values, or if
    /// the range is infinite.
    pub fn of<V: OrderedValues + ?Sized>(values: &V, max_bins: usize) -> Option<Self> {
        let (lo, hi) = shown_range(values).filter(|(lo, hi)| lo.is_finite() && hi.is_finite())?;
        if lo == hi {
            // A bin needs a width that is not 0; any width will do.
            let width = lo.abs().max(f64::MIN_POSITIVE) / 50.0;
            return Some(Self { range: (lo, hi), from: lo - width / 2.0, width, count: 1 });
        }
        let interquartile_range = values.interpolated_quantile(0.75)? - values.interpolated_quantile(0.25)?;
        let bin_count = (hi - lo) / (2.0 * interquartile_range / (values.count() as f64).cbrt());
        // If all but a few values are equal, the interquartile range gives no width.
        let bin_count = if bin_count.is_finite() { bin_count.ceil() as usize } else { MAX_BINS };
        let count = bin_count.clamp(MIN_BINS, MAX_BINS).min(max_bins.max(1));
        Some(Self { range: (lo, hi), from: lo, width: (hi - lo) / count as f64, count })
    }

    /// Returns the edges of the bins in ascending order, one more than there are bins.
    pub fn edges(&self) -> Vec<f64> {
        (0..=self.count).map(|number| self.from + self.width * number as f64).collect()
    }
}

/// Values of a summary, counted in bins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BinCounts {
    /// Number of values below the first bin.
    pub below: u64,
    /// Number of values in each bin.
    pub counts: Vec<u64>,
    /// Number of values above the last bin.
    pub above: u64,
}

impl Summary {
    /// Returns the number of values below each edge of the bins, for drawing; it may have a fractional part. `edges`
    /// must be ascending. `range` is the range of the values that are shown: the outer bin at one of its ends is open
    /// if no value lies beyond this end.
    pub fn counts_below(&self, edges: &[f64], range: (f64, f64)) -> Vec<f64> {
        let total = self.count() as f64;
        let below = |x: &f64| self.fraction_below(*x).unwrap_or(0.0) * total;
        let mut counts: Vec<f64> = edges.iter().map(below).collect();
        // The edges are rounded. Because of this, the smallest value could lie below the first bin, or the largest
        // above the last bin.
        if let Some(first) = counts.first_mut().filter(|_| range.0 <= self.moments.min) {
            *first = 0.0;
        }
        if let Some(last) = counts.last_mut().filter(|_| range.1 >= self.moments.max) {
            *last = total;
        }
        counts
    }

    /// Counts the values in each bin, below the first bin and above the last bin. Each value is counted once. `edges`
    /// and `range` are those of [`Self::counts_below`].
    pub fn count_in(&self, edges: &[f64], range: (f64, f64)) -> BinCounts {
        // The cumulative counts are rounded, not the counts of the bins, so that the counts add up to the number of
        // values.
        let cumulative = self.counts_below(edges, range).into_iter().map(|count| count.round() as u64);
        let cumulative: Vec<u64> = cumulative.collect();
        let [first, last] = [cumulative.first(), cumulative.last()].map(|count| count.copied().unwrap_or(0));
        let counts = cumulative.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        BinCounts { below: first, counts, above: self.count() - last }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    fn sorted_and_summary(values: impl IntoIterator<Item = f64>) -> (Vec<f64>, Summary) {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut summary = Summary::default();
        sorted.iter().for_each(|value| summary.record(*value));
        (sorted, summary)
    }

    #[test]
    fn summary_has_range_and_bins_of_its_values() {
        let mut noise = SplitMix64::new(5);
        let log_normal: Vec<f64> = (0..5_000).map(|_| 0.010 * (0.4 * noise.normal()).exp()).collect();
        let with_stalls = log_normal.iter().copied().chain([1.0, 2.0, 9.0]);
        for values in [log_normal.clone(), with_stalls.collect(), (1..=40).map(f64::from).collect()] {
            let (sorted, summary) = sorted_and_summary(values);
            let exact = Binning::of(sorted.as_slice(), MAX_BINS).expect("values");
            let stored = Binning::of(&summary, MAX_BINS).expect("values");
            let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.03;
            assert!(
                near(exact.range.0, stored.range.0) && near(exact.range.1, stored.range.1),
                "{exact:?} {stored:?}"
            );
            assert!(exact.count.abs_diff(stored.count) <= 2, "{exact:?} {stored:?}");
            let outside = sorted.iter().filter(|value| **value > exact.range.1).count() as u64;
            let counts = summary.count_in(&stored.edges(), stored.range);
            assert_eq!((counts.below, counts.above), (0, outside));
            assert_eq!(counts.counts.iter().sum::<u64>() + outside, sorted.len() as u64);
        }
    }

    #[test]
    fn counts_of_bins_add_up_to_count() {
        let (_, summary) = sorted_and_summary((1..=1000).map(f64::from));
        let edges = [0.0, 250.0, 500.0, 750.0, 1001.0];
        let BinCounts { below, counts, above } = summary.count_in(&edges, (0.0, 1001.0));
        assert_eq!((below, counts.iter().sum::<u64>(), above), (0, 1000, 0));
        assert!(counts.iter().all(|count| count.abs_diff(250) < 10), "{counts:?}");
    }

    #[test]
    fn equal_values_of_summary_are_in_one_bin() {
        for value in [0.0, -3.0, 1e-9, 7.0] {
            let (_, summary) = sorted_and_summary([value; 40]);
            let binning = Binning::of(&summary, MAX_BINS).expect("values");
            assert_eq!((binning.range, binning.count), ((value, value), 1));
            let counts = summary.count_in(&binning.edges(), binning.range);
            assert_eq!(counts, BinCounts { below: 0, counts: vec![40], above: 0 });
        }
        assert_eq!(Binning::of(&Summary::default(), MAX_BINS), None);
        assert_eq!(Binning::of([1.0_f64, 2.0, 3.0].as_slice(), 2).map(|bins| bins.count), Some(2));
    }
}
