//! Logarithmic axes.

/// A logarithmic axis: values above 0 to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axis {
    /// Smallest and largest value.
    pub(super) values: (f64, f64),
    /// Where they are.
    pub(super) pixels: (i32, i32),
}

impl Axis {
    /// The pixel of a value; values beyond the ends lie at the ends.
    pub(super) fn at(&self, value: f64) -> i32 {
        let (lo, hi) = self.values;
        let share = (value.clamp(lo, hi) / lo).ln() / (hi / lo).ln();
        self.pixels.0 + (share * f64::from(self.pixels.1 - self.pixels.0)).round() as i32
    }

    /// So many values along the axis, evenly spaced as seen.
    pub(super) fn along(&self, steps: u32) -> impl Iterator<Item = f64> {
        let (lo, hi) = self.values;
        (0..=steps).map(move |step| lo * (hi / lo).powf(f64::from(step) / f64::from(steps)))
    }

    /// Where the axis is marked: powers of ten, with 2 and 5 between them where those alone are fewer than three.
    pub(super) fn ticks(&self) -> Vec<f64> {
        let (lo, hi) = self.values;
        let decades = (lo.log10().floor() as i32)..=(hi.log10().ceil() as i32);
        let marks = |steps: &'static [f64]| -> Vec<f64> {
            let all =
                decades.clone().flat_map(|decade| steps.iter().map(move |step| step * 10_f64.powi(decade)));
            all.filter(|value| (lo..=hi).contains(value)).collect()
        };
        let powers = marks(&[1.0]);
        if powers.len() < 3 { marks(&[1.0, 2.0, 5.0]) } else { powers }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_lie_where_their_logarithm_does_and_never_outside() {
        let axis = Axis { values: (1.0, 1e4), pixels: (100, 500) };
        assert_eq!([1.0, 10.0, 1e4, 0.0, 1e9].map(|value| axis.at(value)), [100, 200, 500, 100, 500]);
        assert_eq!(axis.ticks().len(), 5);
        let short = Axis { values: (0.3, 7.0), pixels: (500, 0) };
        assert_eq!(
            short.ticks().iter().map(|tick| (tick * 10.0).round()).collect::<Vec<_>>(),
            [5.0, 10.0, 20.0, 50.0]
        );
    }
}
