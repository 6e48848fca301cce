//! Theil–Sen: the median of the slopes of all pairs.

use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF, Normal};

use super::{CONFIDENCE, Estimate, Fit, Point, can_be_fitted};
use crate::order::SortedValues;

/// Halvings of the range of slopes: more than a double has bits.
const HALVINGS: usize = 80;

/// Returns the line whose slope is the median of the slopes of all pairs of points with different x (Theil 1950), and whose intercept is
/// the median of the residuals of y. `None` when there are fewer than three points or all have the same x.
///
/// The slope's interval is that of Sen 1968, with his correction for equal x: the pairs' slopes at the ranks that Kendall's statistic
/// allows. The intercept's interval joins the slope's uncertainty and the median's (sign test), each at half the risk (Bonferroni), so that
/// it is valid for any common distribution of deviations.
///
/// Each count of the pairs takes O(n log n) time, and the pairs are not stored, so that 100,000 samples are possible.
pub fn theil_sen(points: &[Point]) -> Option<Fit> {
    if !can_be_fitted(points.iter().copied()) {
        return None;
    }
    let pairs = Pairs::new(points);
    let (below, above) = ((pairs.count - 1) / 2, pairs.count / 2);
    let slope = f64::midpoint(pairs.slope(below), pairs.slope(above));
    let left = |slope: f64| points.iter().map(|point| point.y - slope * point.x).collect::<SortedValues>();
    let intercept = left(slope).median()?;

    let half_risk = f64::midpoint(1.0, CONFIDENCE);
    let interval = pairs.interval(half_risk).zip(median_ranks(points.len(), half_risk));
    let intercept_interval = interval.map(|((flat, steep), (low, high))| {
        let (one, other) = (left(flat), left(steep));
        let (one, other) = (one.values(), other.values());
        (one[low].min(other[low]), one[high].max(other[high]))
    });
    Some(Fit {
        intercept: Estimate { value: intercept, standard_error: None, interval: intercept_interval },
        slope: Estimate { value: slope, standard_error: None, interval: pairs.interval(CONFIDENCE) },
        points: points.len(),
    })
}

/// All pairs of points with different x, without a list of them.
struct Pairs {
    /// The points by x; the y of each x in order.
    groups: Vec<(f64, Vec<f64>)>,
    /// Number of pairs.
    count: u64,
    /// The flattest and the steepest slope.
    range: (f64, f64),
}

impl Pairs {
    fn new(points: &[Point]) -> Self {
        let mut points = points.to_vec();
        points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let groups: Vec<(f64, Vec<f64>)> = points
            .chunk_by(|a, b| a.x == b.x)
            .map(|group| (group[0].x, group.iter().map(|point| point.y).collect()))
            .collect();
        let choose = |n: usize| (n as u64) * (n as u64).saturating_sub(1) / 2;
        let count = choose(points.len()) - groups.iter().map(|(_, group)| choose(group.len())).sum::<u64>();
        // A slope over several groups is an average of slopes between neighbours, so the extremes are among those.
        let slopes = groups.windows(2).flat_map(|pair| {
            let ((x, low), (to, high)) = (&pair[0], &pair[1]);
            let rise =
                |from: Option<&f64>, to: Option<&f64>| to.zip(from).map_or(0.0, |(to, from)| to - from);
            [rise(low.last(), high.first()) / (to - x), rise(low.first(), high.last()) / (to - x)]
        });
        let range = slopes.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), s| (lo.min(s), hi.max(s)));
        Self { groups, count, range }
    }

    /// Returns the slope of rank `rank`, from 0.
    ///
    /// Found by bisection of the range of slopes: the number of pairs that are no steeper than a slope is the number of pairs that do not
    /// rise after subtracting the slope from all points, and a merge sort counts these as inversions.
    fn slope(&self, rank: u64) -> f64 {
        let (mut lo, mut hi) = self.range;
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(lo, hi);
            if middle <= lo || middle >= hi {
                break;
            }
            if self.count_not_steeper(middle) > rank { hi = middle } else { lo = middle }
        }
        f64::midpoint(lo, hi)
    }

    fn count_not_steeper(&self, slope: f64) -> u64 {
        let level = |(x, group): &(f64, Vec<f64>)| group.iter().map(|y| y - slope * x).collect::<Vec<_>>();
        let mut runs: Vec<Vec<f64>> = self.groups.iter().map(level).collect();
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

    /// Returns the interval of the median slope: ranks around the middle, at the distance that Kendall's statistic allows. `None` when that
    /// exceeds the number of slopes.
    fn interval(&self, confidence: f64) -> Option<(f64, f64)> {
        let sum = |n: f64| n * (n - 1.0) * (2.0 * n + 5.0);
        let points: usize = self.groups.iter().map(|(_, group)| group.len()).sum();
        let equal: f64 = self.groups.iter().map(|(_, group)| sum(group.len() as f64)).sum();
        let deviation = ((sum(points as f64) - equal) / 18.0).sqrt();
        let away = deviation * Normal::standard().inverse_cdf(f64::midpoint(1.0, confidence));
        // Sen's ranks M1 and M2 + 1, counted from 1.
        let (low, high) = ((self.count as f64 - away) / 2.0, (self.count as f64 + away) / 2.0);
        if low.round() < 1.0 {
            return None;
        }
        Some((self.slope(low.round() as u64 - 1), self.slope(high.round() as u64)))
    }
}

/// Merges two runs; adds to `count` the pairs whose right element is no higher than the left one.
fn merge(left: &[f64], right: &[f64], count: &mut u64) -> Vec<f64> {
    let mut merged = Vec::with_capacity(left.len() + right.len());
    let mut taken = 0;
    for &value in right {
        let lower = left[taken..].iter().take_while(|other| **other < value).count();
        merged.extend_from_slice(&left[taken..taken + lower]);
        taken += lower;
        *count += (left.len() - taken) as u64;
        merged.push(value);
    }
    merged.extend_from_slice(&left[taken..]);
    merged
}

/// Returns the ranks, from 0, of the two of `n` values that contain the median between them with this confidence (sign test); `None` when
/// all of them would not suffice.
fn median_ranks(n: usize, confidence: f64) -> Option<(usize, usize)> {
    let heads = Binomial::new(0.5, n as u64).ok()?;
    let risk = (1.0 - confidence) / 2.0;
    // Above a thousand values the normal approximation is accurate and much faster.
    let outside = if n > 1000 {
        let away = Normal::standard().inverse_cdf(1.0 - risk) * (n as f64).sqrt() / 2.0;
        (n as f64 / 2.0 - away).floor() as usize
    } else {
        (0..n).take_while(|rank| heads.cdf(*rank as u64) <= risk).count()
    };
    Some((outside.checked_sub(1)?, n - outside))
}
