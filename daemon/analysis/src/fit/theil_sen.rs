//! Line fit by Theil and Sen: its slope is the median of the slopes of all pairs of points.

use std::ops::Range;

use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF, Normal};

use super::{CONFIDENCE, Estimate, Fit, Point, can_be_fitted};
use crate::order::{SortedValues, kendall_variance};

/// Maximum number of steps of the bisection. The result is then exact to the range of the slopes divided by 2⁸⁰.
const MAX_BISECTIONS: usize = 80;

/// Returns the line whose slope is the median of the slopes of all pairs of points with different x (Theil 1950), and
/// whose intercept is the median of the residuals `y − slope · x`. `None` if there are fewer than
/// three points, if all points have the same x, or if a coordinate is not finite.
///
/// The interval of the slope is Sen's (1968), with his correction for equal x. Its ends are the slopes of two pairs.
/// The ranks of these slopes follow from Kendall's statistic. The interval of the intercept combines two uncertainties:
/// the uncertainty of the slope, and the uncertainty of the median (sign test). Each gets half the risk (Bonferroni).
/// The intervals are valid for any distribution of the deviations from the line, if the distribution is the same for
/// all points.
///
/// Counting the pairs takes O(n log n) time, and the pairs are not stored, so that 100,000 samples are possible.
pub fn theil_sen(points: &[Point]) -> Option<Fit> {
    if !can_be_fitted(points.iter().copied()) {
        return None;
    }
    let pairs = Pairs::new(points);
    let (lower_middle, upper_middle) = ((pairs.count - 1) / 2, pairs.count / 2);
    let slope = f64::midpoint(pairs.slope(lower_middle), pairs.slope(upper_middle));
    let residuals =
        |slope: f64| points.iter().map(|point| point.y - slope * point.x).collect::<SortedValues>();
    let intercept = residuals(slope).median()?;

    let confidence_at_half_risk = f64::midpoint(1.0, CONFIDENCE);
    // The interval of the slope, and the ranks of the two residuals between which the median of all residuals lies.
    let slopes_and_ranks =
        pairs.interval(confidence_at_half_risk).zip(median_ranks(points.len(), confidence_at_half_risk));
    let intercept_interval = slopes_and_ranks.map(|((low_slope, high_slope), (low_rank, high_rank))| {
        let residuals = [residuals(low_slope), residuals(high_slope)];
        let [of_low_slope, of_high_slope] = residuals.each_ref().map(SortedValues::values);
        (
            of_low_slope[low_rank].min(of_high_slope[low_rank]),
            of_low_slope[high_rank].max(of_high_slope[high_rank]),
        )
    });
    Some(Fit {
        intercept: Estimate { value: intercept, standard_error: None, interval: intercept_interval },
        slope: Estimate { value: slope, standard_error: None, interval: pairs.interval(CONFIDENCE) },
        points: points.len(),
    })
}

/// All pairs of points with different x. The pairs themselves are not stored.
struct Pairs {
    /// Each x of the points, in ascending order, with the y of all points that have this x, in ascending order, too.
    groups: Vec<(f64, Vec<f64>)>,
    /// Number of pairs.
    count: u64,
    /// Lowest and highest slope.
    range: (f64, f64),
    /// Ranks of the slopes that are exactly 0, from 0.
    zero_ranks: Range<u64>,
}

impl Pairs {
    fn new(points: &[Point]) -> Self {
        let mut points = points.to_vec();
        points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let groups: Vec<(f64, Vec<f64>)> = points
            .chunk_by(|a, b| a.x == b.x)
            .map(|group| (group[0].x, group.iter().map(|point| point.y).collect()))
            .collect();
        let pair_count = |n: usize| (n as u64) * (n as u64).saturating_sub(1) / 2;
        let count =
            pair_count(points.len()) - groups.iter().map(|(_, group)| pair_count(group.len())).sum::<u64>();
        // A slope over several groups is an average of slopes between neighbouring groups. The lowest and the highest
        // slope are therefore slopes between neighbouring groups.
        let slopes = groups.windows(2).flat_map(|pair| {
            let ((left_x, left), (right_x, right)) = (&pair[0], &pair[1]);
            // No group is empty, so the 0 is never used.
            let rise =
                |from: Option<&f64>, to: Option<&f64>| to.zip(from).map_or(0.0, |(to, from)| to - from);
            let run = right_x - left_x;
            [rise(left.last(), right.first()) / run, rise(left.first(), right.last()) / run]
        });
        let range = slopes.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), s| (lo.min(s), hi.max(s)));
        let mut pairs = Self { groups, count, range, zero_ranks: 0..0 };
        pairs.zero_ranks = pairs.count_below_zero()..pairs.count_not_above(0.0);
        pairs
    }

    /// Returns the number of pairs whose slope is below 0.
    fn count_below_zero(&self) -> u64 {
        // The negated points have the negated slopes. A group of negated values is in ascending order if it is reversed.
        let negated =
            |(x, group): &(f64, Vec<f64>)| (*x, group.iter().rev().map(|y| -y).collect::<Vec<f64>>());
        let groups = self.groups.iter().map(negated).collect();
        let not_below_zero = Self { groups, count: self.count, range: self.range, zero_ranks: 0..0 };
        self.count - not_below_zero.count_not_above(0.0)
    }

    /// Returns the slope with this rank, from 0, in the ascending order of the slopes.
    ///
    /// The range of slopes is bisected. Each step counts the pairs with at most a given slope in O(n log n): the line
    /// with this slope is subtracted from all points, and then a merge sort counts its inversions, which are the pairs
    /// that do not rise.
    fn slope(&self, rank: u64) -> f64 {
        // The bisection would return a tiny number with any sign, and a slope of this sign would seem to be certain.
        if self.zero_ranks.contains(&rank) {
            return 0.0;
        }
        let (mut lo, mut hi) = self.range;
        for _ in 0..MAX_BISECTIONS {
            let middle = f64::midpoint(lo, hi);
            if middle <= lo || middle >= hi {
                break;
            }
            if self.count_not_above(middle) > rank { hi = middle } else { lo = middle }
        }
        f64::midpoint(lo, hi)
    }

    /// Returns the number of pairs whose slope is at most `slope`.
    fn count_not_above(&self, slope: f64) -> u64 {
        let residuals =
            |(x, group): &(f64, Vec<f64>)| group.iter().map(|y| y - slope * x).collect::<Vec<_>>();
        // A run is a sorted list of the merge sort. All points of a group begin in the same run, so that pairs of equal
        // x, which have no slope, are not counted.
        let mut runs: Vec<Vec<f64>> = self.groups.iter().map(residuals).collect();
        let mut count = 0;
        while runs.len() > 1 {
            let merged = runs.chunks(2).map(|pair| match pair {
                [left, right] => merge(left, right, &mut count),
                rest => rest.concat(),
            });
            runs = merged.collect();
        }
        count
    }

    /// Returns the interval of the median slope. Its ends are the slopes with two ranks. The distance of these ranks
    /// from the middle rank follows from Kendall's statistic. `None` if there are so few pairs that no pair has such a
    /// rank.
    fn interval(&self, confidence: f64) -> Option<(f64, f64)> {
        let deviation = kendall_variance(self.groups.iter().map(|(_, group)| group.len())).sqrt();
        let width = deviation * Normal::standard().inverse_cdf(f64::midpoint(1.0, confidence));
        // Sen's ranks M1 and M2 + 1, counted from 1.
        let (low, high) = ((self.count as f64 - width) / 2.0, (self.count as f64 + width) / 2.0);
        if low.round() < 1.0 {
            return None;
        }
        Some((self.slope(low.round() as u64 - 1), self.slope(high.round() as u64)))
    }
}

/// Merges two sorted runs. Adds to `count` the number of pairs whose element of `right` is not larger than the element
/// of `left`.
fn merge(left: &[f64], right: &[f64], count: &mut u64) -> Vec<f64> {
    let mut merged = Vec::with_capacity(left.len() + right.len());
    // Number of elements of `left` that are already in `merged`.
    let mut merged_left = 0;
    for &value in right {
        let lower = left[merged_left..].iter().take_while(|other| **other < value).count();
        merged.extend_from_slice(&left[merged_left..merged_left + lower]);
        merged_left += lower;
        *count += (left.len() - merged_left) as u64;
        merged.push(value);
    }
    merged.extend_from_slice(&left[merged_left..]);
    merged
}

/// Returns the ranks, counted from 0, of two of `n` sorted values. The median lies between these two values with the
/// given confidence (sign test). `None` if `n` is so small that even the smallest and the largest value give less
/// confidence.
fn median_ranks(n: usize, confidence: f64) -> Option<(usize, usize)> {
    let values_below_median = Binomial::new(0.5, n as u64).ok()?;
    let risk = (1.0 - confidence) / 2.0;
    // Number of values up to and including the lower of the two values. With more than a thousand values, the normal
    // approximation of the binomial distribution is accurate and much faster.
    let lower_count = if n > 1000 {
        let half_width = Normal::standard().inverse_cdf(1.0 - risk) * (n as f64).sqrt() / 2.0;
        (n as f64 / 2.0 - half_width).floor() as usize
    } else {
        (0..n).take_while(|rank| values_below_median.cdf(*rank as u64) <= risk).count()
    };
    Some((lower_count.checked_sub(1)?, n - lower_count))
}
