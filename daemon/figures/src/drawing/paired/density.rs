//! Kernel density estimate of the distribution of values.

use peernet_analysis::order::SortedValues;
use peernet_statistics::Moments;

/// Number of evaluation points for each width of the kernel. With this number, no peak is missed between two points.
const POINTS_PER_WIDTH: f64 = 4.0;
/// Minimum number of evaluation points.
const MIN_POINTS: usize = 24;
/// Maximum number of evaluation points.
const MAX_POINTS: usize = 768;
/// Number of cells into which the values are counted before the densities are computed. The time to compute the density
/// at a point then depends on the number of cells, not on the number of values.
const CELLS: usize = MAX_POINTS;

/// Returns evaluation points between `lo` and `hi`, each with the density at this point as a share of the highest
/// density.
///
/// The kernel is Gaussian with Silverman's width, 0.9 · min(s, IQR / 1.34) · n^−1/5 (*Density Estimation*, 1986,
/// equation 3.31). Here s is the standard deviation and IQR the interquartile range of all values, and n is the number
/// of finite values in the range. The result is empty if the range is empty, if there are fewer than two values, or if
/// all values are equal.
pub(super) fn density(values: &SortedValues, (lo, hi): (f64, f64)) -> Vec<(f64, f64)> {
    let values_in_range =
        || values.values().iter().filter(|value| value.is_finite() && (lo..=hi).contains(value));
    let n = values_in_range().count() as f64;
    let Some(width) = kernel_width(values, n).filter(|_| hi > lo) else { return Vec::new() };
    let cell_width = (hi - lo) / CELLS as f64;
    let mut counts = [0_u32; CELLS];
    values_in_range().for_each(|value| counts[(((value - lo) / cell_width) as usize).min(CELLS - 1)] += 1);
    // A kernel that is narrower than a cell would fall between the cells.
    let width = width.max(cell_width);
    let steps = ((POINTS_PER_WIDTH * (hi - lo) / width).ceil() as usize).clamp(MIN_POINTS, MAX_POINTS);
    let evaluation_point = |step: usize| lo + (hi - lo) * step as f64 / steps as f64;
    let density_at = |point: f64| -> f64 {
        let contributions =
            counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(cell, count)| {
                let distance = (point - lo - cell_width * (cell as f64 + 0.5)) / width;
                f64::from(*count) * (-distance * distance / 2.0).exp()
            });
        contributions.sum()
    };
    let heights: Vec<f64> = (0..=steps).map(|step| density_at(evaluation_point(step))).collect();
    let highest = heights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    heights.into_iter().enumerate().map(|(step, height)| (evaluation_point(step), height / highest)).collect()
}

/// Returns the width of the kernel for `n` values in the range; `None` if the values have no spread.
fn kernel_width(values: &SortedValues, n: f64) -> Option<f64> {
    let scaled_iqr = (values.quantile(0.75)? - values.quantile(0.25)?) / 1.34;
    let s = values.values().iter().copied().collect::<Moments>().std()?;
    // If half of the values are equal, the interquartile range can be 0, although the values are not all equal.
    let spread = if scaled_iqr > 0.0 { scaled_iqr.min(s) } else { s };
    let width = 0.9 * spread * n.powf(-0.2);
    (width.is_finite() && width > 0.0).then_some(width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn density_is_low_between_two_peaks() {
        let peak = |middle: f64| (0..500).map(move |i| middle + ((f64::from(i) + 0.5) / 500.0 - 0.5).powi(3));
        let values: SortedValues = peak(1.0).chain(peak(5.0)).collect();
        let density = density(&values, (0.5, 5.5));
        let density_near = |x: f64| {
            let nearest = density.iter().min_by(|a, b| (a.0 - x).abs().total_cmp(&(b.0 - x).abs()));
            nearest.expect("points").1
        };
        assert!(density_near(1.0) > 0.9 && density_near(5.0) > 0.9 && density_near(3.0) < 0.3, "{density:?}");
    }

    #[test]
    fn narrow_peak_far_from_tail_is_visible() {
        // The peak is 0.4 wide, and the range is 39 wide.
        let peak = (0..150).map(|i| 2.0 + 0.4 * (f64::from(i) + 0.5) / 150.0);
        let density = density(&peak.chain([30.0, 41.0]).collect(), (2.0, 41.0));
        let in_peak = density.iter().filter(|(x, density)| (2.0..=2.4).contains(x) && *density > 0.5);
        assert!(in_peak.count() >= 6, "{density:?}");
    }

    #[test]
    fn kernel_width_has_deviation_of_all_values() {
        // The standard deviation is 2 and the interquartile range is 0. The largest value is not in the range.
        let values = [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0 + 32.0_f64.sqrt()];
        let width = kernel_width(&values.into_iter().collect(), 7.0).expect("has a spread");
        assert!((width - 0.9 * 2.0 * 7.0_f64.powf(-0.2)).abs() < 1e-9, "{width}");
    }

    #[test]
    fn equal_values_or_too_few_values_have_no_density() {
        assert_eq!(density(&[2.0; 50].into_iter().collect(), (1.0, 3.0)), []);
        assert_eq!(density(&SortedValues::default(), (1.0, 3.0)), []);
        assert_eq!(density(&[2.0].into_iter().collect(), (1.0, 3.0)), []);
    }
}
