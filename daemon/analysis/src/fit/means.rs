//! Line fit to means over sizes.

use super::{Fit, Point, Weighted, least_squares};

/// Sizes within this factor are one size.
const SAME_SIZE_RATIO: f64 = 1.1;
/// Minimum number of sizes for a line.
pub const MIN_SIZES: usize = 3;

/// Mean of a quantity at one size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanAtSize {
    /// The size.
    pub size: f64,
    /// Number of values.
    pub count: u64,
    /// Mean of the values.
    pub mean: f64,
    /// Sample standard deviation; `None` below two values.
    pub std: Option<f64>,
}

/// Returns whether two sizes differ by less than a tenth, so they count as one size.
pub fn is_same_size(a: f64, b: f64) -> bool {
    a.max(b) <= a.min(b) * SAME_SIZE_RATIO
}

/// Returns the number of sizes that differ by a tenth or more.
pub fn distinct_sizes(sizes: impl Iterator<Item = f64>) -> usize {
    let mut distinct: Vec<f64> = Vec::new();
    for size in sizes {
        if !distinct.iter().any(|other| is_same_size(*other, size)) {
            distinct.push(size);
        }
    }
    distinct.len()
}

/// Returns the line through means, each weighted by the reciprocal of its variance. If one variance is not known, all means have the same
/// weight. `None` with fewer than three distinct sizes.
pub fn line_through_means(means: &[MeanAtSize]) -> Option<Fit> {
    (distinct_sizes(means.iter().map(|mean| mean.size)) >= MIN_SIZES).then_some(())?;
    let weight = |mean: &MeanAtSize| {
        let std = mean.std.filter(|std| *std > 0.0)?;
        Some(mean.count as f64 / (std * std))
    };
    let weights: Option<Vec<f64>> = means.iter().map(weight).collect();
    let weights = weights.unwrap_or_else(|| vec![1.0; means.len()]);
    let points = means.iter().zip(weights);
    let points =
        points.map(|(mean, weight)| Weighted { point: Point { x: mean.size, y: mean.mean }, weight });
    least_squares(&points.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(size: f64, mean: f64) -> MeanAtSize {
        MeanAtSize { size, count: 100, mean, std: Some(0.1) }
    }

    #[test]
    fn line_needs_three_sizes() {
        assert_eq!(distinct_sizes([1.0, 1.05, 2.0, 2.1].into_iter()), 2);
        assert_eq!(line_through_means(&[at(1.0, 1.0), at(1.05, 1.0), at(2.0, 2.0)]), None);
        let fit = line_through_means(&[at(1.0, 3.0), at(2.0, 5.0), at(3.0, 7.0)]).expect("three sizes");
        assert!((fit.slope.value - 2.0).abs() < 1e-9 && (fit.intercept.value - 1.0).abs() < 1e-9, "{fit:?}");
    }

    #[test]
    fn uncertain_mean_hardly_moves_line() {
        let uncertain = MeanAtSize { count: 2, std: Some(5.0), ..at(4.0, 30.0) };
        let fit = line_through_means(&[at(1.0, 3.0), at(2.0, 5.0), at(3.0, 7.0), uncertain]).expect("sizes");
        assert!((fit.slope.value - 2.0).abs() < 0.1, "{fit:?}");
    }
}
