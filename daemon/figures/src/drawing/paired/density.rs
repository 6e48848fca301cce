//! Kernel density of values.

use peernet_analysis::order::SortedValues;

/// Places for each width of the kernel, so that no hill falls between two of them.
const PLACES_PER_WIDTH: f64 = 4.0;
/// Minimum and maximum number of places.
const MIN_PLACES: usize = 24;
const MAX_PLACES: usize = 768;
/// Number of cells that values are counted into first, so that the cost does not depend on the number of values.
const CELLS: usize = MAX_PLACES;

/// Returns places between `lo` and `hi` with the density of the values there, the densest place being 1: a Gaussian kernel of Silverman's
/// width, 0.9 · min(s, IQR / 1.34) · n^−1/5 (*Density Estimation*, 1986, equation 3.31). Empty if all values are equal.
pub(super) fn density(values: &SortedValues, (lo, hi): (f64, f64)) -> Vec<(f64, f64)> {
    let finite = || values.values().iter().filter(|value| value.is_finite() && (lo..=hi).contains(value));
    let n = finite().count() as f64;
    let Some(width) = kernel(values, n).filter(|_| hi > lo) else { return Vec::new() };
    let cell = (hi - lo) / CELLS as f64;
    let mut cells = [0_u32; CELLS];
    finite().for_each(|value| cells[(((value - lo) / cell) as usize).min(CELLS - 1)] += 1);
    // A kernel that is narrower than a cell would fall between the cells.
    let width = width.max(cell);
    let steps = ((PLACES_PER_WIDTH * (hi - lo) / width).ceil() as usize).clamp(MIN_PLACES, MAX_PLACES);
    let at = |step: usize| lo + (hi - lo) * step as f64 / steps as f64;
    let dense = |place: f64| -> f64 {
        let parts = cells.iter().enumerate().filter(|(_, count)| **count > 0).map(|(number, count)| {
            let away = (place - lo - cell * (number as f64 + 0.5)) / width;
            f64::from(*count) * (-away * away / 2.0).exp()
        });
        parts.sum()
    };
    let heights: Vec<f64> = (0..=steps).map(|step| dense(at(step))).collect();
    let highest = heights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    heights.into_iter().enumerate().map(|(step, height)| (at(step), height / highest)).collect()
}

fn kernel(values: &SortedValues, n: f64) -> Option<f64> {
    let middle_half = (values.quantile(0.75)? - values.quantile(0.25)?) / 1.34;
    let mean = values.values().iter().sum::<f64>() / n;
    let s = (values.values().iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    // If half of the values are equal, the quartiles do not describe the rest.
    let spread = if middle_half > 0.0 { middle_half.min(s) } else { s };
    let width = 0.9 * spread * n.powf(-0.2);
    (width.is_finite() && width > 0.0).then_some(width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_hills_are_two_hills() {
        let hill = |middle: f64| (0..500).map(move |i| middle + ((f64::from(i) + 0.5) / 500.0 - 0.5).powi(3));
        let values: SortedValues = hill(1.0).chain(hill(5.0)).collect();
        let density = density(&values, (0.5, 5.5));
        let near = |place: f64| {
            let close = density.iter().min_by(|a, b| (a.0 - place).abs().total_cmp(&(b.0 - place).abs()));
            close.expect("places").1
        };
        assert!(near(1.0) > 0.9 && near(5.0) > 0.9 && near(3.0) < 0.3, "{density:?}");
    }

    #[test]
    fn narrow_peak_far_from_tail_is_visible() {
        // 0.4 of a unit wide, on 40 units.
        let hill = (0..150).map(|i| 2.0 + 0.4 * (f64::from(i) + 0.5) / 150.0);
        let density = density(&hill.chain([30.0, 41.0]).collect(), (2.0, 41.0));
        let on_it = density.iter().filter(|(place, dense)| (2.0..=2.4).contains(place) && *dense > 0.5);
        assert!(on_it.count() >= 6, "{density:?}");
    }

    #[test]
    fn what_has_no_width_has_no_density() {
        assert_eq!(density(&[2.0; 50].into_iter().collect(), (1.0, 3.0)), []);
        assert_eq!(density(&SortedValues::default(), (1.0, 3.0)), []);
        assert_eq!(density(&[2.0].into_iter().collect(), (1.0, 3.0)), []);
    }
}
