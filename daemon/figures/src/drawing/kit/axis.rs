//! Axes.

use peernet_statistics::number::{fixed, significant};

/// What ends of axes are held within, and what counts as zero.
const MOST: f64 = 1e150;
const LEAST: f64 = 1e-150;

/// How values are spread along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scale {
    Linear,
    Logarithmic,
}

/// An axis: values to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::drawing) struct Axis {
    /// Smallest and largest value.
    pub(in crate::drawing) values: (f64, f64),
    /// Where they are.
    pub(in crate::drawing) pixels: (i32, i32),
    scale: Scale,
    /// Smallest distance between two marks.
    least: f64,
}

/// Where an axis is marked.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::drawing) struct Tick {
    pub(in crate::drawing) value: f64,
    pub(in crate::drawing) text: String,
}

impl Axis {
    /// An even axis. One value alone is given room on both sides.
    pub(in crate::drawing) fn linear(values: (f64, f64), pixels: (i32, i32)) -> Self {
        let (lo, hi) = held(values);
        let values = if hi > lo { (lo, hi) } else { room_around(lo) };
        Self { values, pixels, scale: Scale::Linear, least: 0.0 }
    }

    /// An even axis from zero, or from the smallest value where that is negative, with a little room beyond the values.
    pub(in crate::drawing) fn from_zero(values: (f64, f64), pixels: (i32, i32)) -> Self {
        let (lo, hi) = held(values);
        let (lo, hi) = (lo.min(0.0), hi.max(0.0));
        let room = (hi - lo) * 0.04;
        let values = if hi > lo {
            (if lo < 0.0 { lo - room } else { 0.0 }, if hi > 0.0 { hi + room } else { 0.0 })
        } else {
            (0.0, 1.0)
        };
        Self { values, pixels, scale: Scale::Linear, least: 0.0 }
    }

    /// A logarithmic axis for values above 0.
    pub(in crate::drawing) fn logarithmic(values: (f64, f64), pixels: (i32, i32)) -> Self {
        let (lo, hi) = held(values);
        let lo = lo.max(LEAST);
        let values = if hi > lo { (lo, hi) } else { room_around(lo) };
        Self { values, pixels, scale: Scale::Logarithmic, least: 0.0 }
    }

    /// Marked at whole numbers alone: what is counted.
    pub(in crate::drawing) fn whole(self) -> Self {
        Self { least: 1.0, ..self }
    }

    /// The pixel of a value; values beyond the ends lie at the ends.
    pub(in crate::drawing) fn at(&self, value: f64) -> i32 {
        let (lo, hi) = self.values;
        let value = value.clamp(lo, hi);
        let share = match self.scale {
            Scale::Linear => (value - lo) / (hi - lo),
            Scale::Logarithmic => (value / lo).ln() / (hi / lo).ln(),
        };
        self.pixels.0 + (share * f64::from(self.pixels.1 - self.pixels.0)).round() as i32
    }

    /// Its title, with what is not evident from its marks alone.
    pub(in crate::drawing) fn titled(&self, title: &str) -> String {
        match self.scale {
            Scale::Linear => title.to_owned(),
            Scale::Logarithmic => format!("{title} (log scale)"),
        }
    }

    /// Whether a value lies on the axis.
    pub(in crate::drawing) fn has(&self, value: f64) -> bool {
        (self.values.0..=self.values.1).contains(&value)
    }

    /// So many values along the axis, evenly spaced as seen.
    pub(in crate::drawing) fn along(&self, steps: u32) -> impl Iterator<Item = f64> + use<> {
        let ((lo, hi), scale) = (self.values, self.scale);
        (0..=steps).map(move |step| {
            let share = f64::from(step) / f64::from(steps);
            match scale {
                Scale::Linear => lo + (hi - lo) * share,
                Scale::Logarithmic => lo * (hi / lo).powf(share),
            }
        })
    }

    /// Where the axis is marked, at most so often: round numbers; for a logarithmic one powers of ten, with 2 and 5
    /// between them where those alone are fewer than three, and where these are, round numbers at even distances.
    pub(in crate::drawing) fn ticks(&self, most: u32) -> Vec<Tick> {
        match self.scale {
            Scale::Linear => self.round(most),
            Scale::Logarithmic => self.powers(most),
        }
    }

    fn round(&self, most: u32) -> Vec<Tick> {
        let (lo, hi) = self.values;
        let least = ((hi - lo) / f64::from(most.max(1))).max(self.least);
        let power = 10_f64.powf(least.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
        let step = step.into_iter().find(|step| *step >= least * (1.0 - 1e-9)).unwrap_or(10.0 * power);
        let decimals = usize::try_from(-(step.log10() + 1e-9).floor() as i32).unwrap_or_default();
        let (first, last) = ((lo / step - 1e-6).ceil() as i64, (hi / step + 1e-6).floor() as i64);
        let tick = |number: i64| {
            let value = number as f64 * step;
            Tick { value, text: fixed(value, decimals) }
        };
        (first..=last).map(tick).collect()
    }

    fn powers(&self, most: u32) -> Vec<Tick> {
        let (lo, hi) = self.values;
        let decades = (lo.log10().floor() as i32)..=(hi.log10().ceil() as i32);
        let marks = |steps: &'static [f64]| -> Vec<Tick> {
            let all =
                decades.clone().flat_map(|decade| steps.iter().map(move |step| step * 10_f64.powi(decade)));
            let inside = all.filter(|value| (lo..=hi).contains(value));
            inside.map(|value| Tick { value, text: plain(value) }).collect()
        };
        let found = [marks(&[1.0]), marks(&[1.0, 2.0, 5.0])].into_iter().find(|marks| marks.len() >= 3);
        let found = found.unwrap_or_else(|| self.round(most));
        // Many powers of ten: those between may go, evenly.
        let apart = found.len().div_ceil(2 * most.max(1) as usize).max(1);
        found.into_iter().step_by(apart).collect()
    }
}

/// A range of numbers whose differences and ratios are numbers as well, so that whatever goes along it comes to an end.
fn held((lo, hi): (f64, f64)) -> (f64, f64) {
    let one = |value: f64| if value.abs() >= LEAST { value.clamp(-MOST, MOST) } else { 0.0 };
    (one(lo), one(hi))
}

/// A range with one value in its middle.
fn room_around(value: f64) -> (f64, f64) {
    let half = if value == 0.0 { 0.5 } else { value.abs() * 0.1 };
    (value - half, value + half)
}

/// A power of ten, or 2 or 5 of them, without needless zeros.
fn plain(value: f64) -> String {
    let text = significant(value);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: Axis, most: u32) -> Vec<String> {
        axis.ticks(most).into_iter().map(|tick| tick.text).collect()
    }

    #[test]
    fn values_lie_where_their_logarithm_does_and_never_outside() {
        let axis = Axis::logarithmic((1.0, 1e4), (100, 500));
        assert_eq!([1.0, 10.0, 1e4, 0.0, 1e9].map(|value| axis.at(value)), [100, 200, 500, 100, 500]);
        assert_eq!(axis.ticks(9).len(), 5);
        assert_eq!(texts(Axis::logarithmic((0.3, 7.0), (500, 0)), 9), ["0.5", "1", "2", "5"]);
        assert_eq!(
            texts(Axis::logarithmic((0.029, 0.092), (500, 0)), 5),
            ["0.04", "0.06", "0.08"],
            "never one alone"
        );
        assert_eq!(texts(Axis::logarithmic((1e-9, 1e9), (500, 0)), 5).len(), 10, "every other power of ten");
    }

    #[test]
    fn an_axis_ends_whatever_its_values() {
        let odd =
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, -1e308, 1e17, 0.0, 5e-324, 1e-308, 7.0];
        for values in odd.into_iter().flat_map(|lo| odd.map(|hi| (lo, hi))) {
            for make in [Axis::linear, Axis::from_zero, Axis::logarithmic] {
                let axis = make(values, (500, 0));
                assert!(axis.ticks(6).len() <= 13, "{values:?}");
                assert!(odd.iter().all(|value| (0..=500).contains(&axis.at(*value))), "{values:?}");
                assert!(axis.along(9).all(f64::is_finite), "{values:?}");
            }
        }
    }

    #[test]
    fn even_axes_are_marked_at_round_numbers() {
        let axis = Axis::linear((0.0, 10.0), (500, 0));
        assert_eq!([0.0, 2.5, 10.0, -3.0, 99.0].map(|value| axis.at(value)), [500, 375, 0, 500, 0]);
        assert_eq!(texts(axis, 5), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(
            texts(Axis::linear((0.0612, 0.0618), (0, 9)), 4),
            ["0.0612", "0.0614", "0.0616", "0.0618"]
        );
        assert_eq!(texts(Axis::linear((-1500.0, 2600.0), (0, 9)), 5), ["−1,000", "0", "1,000", "2,000"]);
        assert_eq!(texts(Axis::from_zero((0.0, 2.0), (0, 9)).whole(), 5), ["0", "1", "2"]);
        assert_eq!(texts(Axis::linear((7.0, 7.0), (0, 9)), 5), ["6.5", "7.0", "7.5"]);
        assert_eq!(Axis::from_zero((3.0, 3.0), (0, 9)).values, (0.0, 3.12));
        assert_eq!(Axis::from_zero((0.0, 0.0), (0, 9)).values, (0.0, 1.0));
        assert_eq!(Axis::from_zero((-5.0, -5.0), (0, 9)).values, (-5.2, 0.0));
    }
}
