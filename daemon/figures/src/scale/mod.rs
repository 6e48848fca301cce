//! Scales: positions of values along an axis, and the round numbers at which the axis is marked.
//!
//! A scale works with values and shares of its length, not with pixels: the renderers (`crate::render`) turn shares
//! into points or percent.

mod clock;
mod step;
#[cfg(test)]
mod tests;

pub use clock::times_of_day;
pub use step::round_step;

use peernet_statistics::number::{fixed, significant};

/// Largest magnitude of an end of a scale.
const MAX_MAGNITUDE: f64 = 1e150;
/// Smallest magnitude of an end of a scale other than zero. An end with a smaller magnitude becomes zero.
const MIN_MAGNITUDE: f64 = 1e-150;
/// [`is_wide`] is true for a range if the ratio of its ends is more than this.
const WIDE_RATIO: f64 = 12.0;
/// A linear scale begins at zero unless the smallest value is more than this share of the largest value.
pub(crate) const ZERO_THRESHOLD: f64 = 0.5;
/// Margin that [`Scale::from_zero`] adds beyond the values, as a share of their range.
const MARGIN: f64 = 0.04;
/// [`Scale::decades`] returns a scale only if the ratio of the largest to the smallest value is more than this.
const DECADE: f64 = 10.0;
/// Maximum distance at which [`Scale::at_or_outside`] places a value beyond an end, as a share of the scale's length.
const MAX_OUTSIDE: f64 = 0.05;

/// Spacing of the values along a scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Spacing {
    /// Equal distances are equal differences.
    Linear,
    /// Equal distances are equal factors.
    Logarithmic,
}

/// Range of values and their positions on a length of 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    lo: f64,
    hi: f64,
    spacing: Spacing,
    /// Smallest distance between two ticks, in the unit of the values.
    min_tick_distance: f64,
    /// Distance between two ticks if the scale was [widened](Self::widened); else `None`.
    step: Option<f64>,
    /// True if labels of positive values have a plus sign.
    has_plus_signs: bool,
}

/// Mark on a scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The value.
    pub value: f64,
    /// Position, from 0 to 1.
    pub at: f64,
    /// Label of the mark.
    pub text: String,
}

impl Scale {
    /// Returns a linear scale that ends exactly at these values. If the two values are equal, they lie in the middle of
    /// the scale.
    pub fn linear(values: (f64, f64)) -> Self {
        let (lo, hi) = clamp_to_finite_range(values);
        let (lo, hi) = if hi > lo { (lo, hi) } else { range_around(lo) };
        Self { lo, hi, spacing: Spacing::Linear, min_tick_distance: 0.0, step: None, has_plus_signs: false }
    }

    /// Returns a linear scale that contains zero and both values. A small margin lies beyond a value at an end, but not
    /// beyond zero.
    pub fn from_zero(values: (f64, f64)) -> Self {
        let (lo, hi) = clamp_to_finite_range(values);
        let (lo, hi) = (lo.min(0.0), hi.max(0.0));
        let margin = (hi - lo) * MARGIN;
        let ends = if hi > lo {
            (if lo < 0.0 { lo - margin } else { 0.0 }, if hi > 0.0 { hi + margin } else { 0.0 })
        } else {
            (0.0, 1.0)
        };
        Self::linear(ends)
    }

    /// Returns a linear scale from zero to a round number that is not below `largest`, in about `ticks` steps. If
    /// `largest` is not a positive finite number, the scale ends at 1.
    pub fn up_to(largest: f64, ticks: usize) -> Self {
        let largest = if largest.is_finite() && largest > 0.0 { largest } else { 1.0 };
        Self::linear((0.0, largest)).widened(ticks)
    }

    /// Returns a logarithmic scale that ends at these values; `None` unless they are above zero and span more than a
    /// decade.
    pub fn decades((lo, hi): (f64, f64)) -> Option<Self> {
        (lo > 0.0 && hi > lo * DECADE && hi.is_finite()).then(|| Self::logarithmic((lo, hi)))
    }

    /// Returns a logarithmic scale that ends at these values, which should be above 0.
    pub fn logarithmic(values: (f64, f64)) -> Self {
        let (lo, hi) = clamp_to_finite_range(values);
        let lo = lo.max(MIN_MAGNITUDE);
        let (lo, hi) = if hi > lo { (lo, hi) } else { range_around(lo) };
        Self { lo, hi, spacing: Spacing::Logarithmic, ..Self::linear((lo, hi)) }
    }

    /// Returns the same scale without ticks between whole numbers, for counts.
    #[must_use]
    pub fn whole(self) -> Self {
        Self { min_tick_distance: 1.0, ..self }
    }

    /// Returns the same scale with a plus sign before the labels of positive values.
    #[must_use]
    pub fn signed(self) -> Self {
        Self { has_plus_signs: true, ..self }
    }

    /// Returns the same scale with its ends moved outwards to ticks. The scale has about `ticks` ticks. A logarithmic
    /// scale is returned unchanged.
    #[must_use]
    pub fn widened(self, ticks: usize) -> Self {
        if self.spacing == Spacing::Logarithmic {
            return self;
        }
        let step = round_step(self.hi - self.lo, ticks).max(self.min_tick_distance);
        // The tolerance keeps an end that is a tick already from moving to the next tick, because the division rounds.
        let (lo, hi) = ((self.lo / step + 1e-9).floor() * step, (self.hi / step - 1e-9).ceil() * step);
        Self { lo, hi, step: Some(step), ..self }
    }

    /// Returns the smallest and the largest value.
    pub fn ends(&self) -> (f64, f64) {
        (self.lo, self.hi)
    }

    /// Returns whether the scale is logarithmic.
    pub fn is_logarithmic(&self) -> bool {
        self.spacing == Spacing::Logarithmic
    }

    /// Returns the position of a value, from 0 to 1. A value beyond an end is placed at this end. NaN is placed at the
    /// lower end.
    pub fn at(&self, value: f64) -> f64 {
        self.at_or_outside(value).clamp(0.0, 1.0)
    }

    /// Returns the position of a value. A value beyond an end is placed slightly outside of the scale, for lines that
    /// leave their plot.
    pub fn at_or_outside(&self, value: f64) -> f64 {
        let position = match self.spacing {
            _ if value.is_nan() => 0.0,
            Spacing::Linear => (value - self.lo) / (self.hi - self.lo),
            Spacing::Logarithmic => (value.max(MIN_MAGNITUDE) / self.lo).ln() / (self.hi / self.lo).ln(),
        };
        position.clamp(-MAX_OUTSIDE, 1.0 + MAX_OUTSIDE)
    }

    /// Returns whether a value lies on the scale.
    pub fn has(&self, value: f64) -> bool {
        (self.lo..=self.hi).contains(&value)
    }

    /// Returns the value between `from` and `to` that is drawn at this share of the distance from `from` to `to`.
    pub fn between(&self, from: f64, to: f64, share: f64) -> f64 {
        if self.is_logarithmic() && from > 0.0 {
            from * (to / from).powf(share)
        } else {
            from + (to - from) * share
        }
    }

    /// Returns `steps + 1` values from end to end, evenly spaced on the drawn axis.
    pub fn along(&self, steps: u32) -> impl Iterator<Item = f64> + use<> {
        let scale = *self;
        (0..=steps).map(move |step| scale.between(scale.lo, scale.hi, f64::from(step) / f64::from(steps)))
    }

    /// Returns the ticks, which are round numbers. A linear scale has about `max_ticks` ticks or fewer, a logarithmic
    /// scale up to twice as many. The ticks of a widened scale do not depend on `max_ticks`.
    ///
    /// A logarithmic scale has ticks at powers of ten. If fewer than three powers lie on the scale, ticks at 2 and 5
    /// times the powers are added. If there are still fewer than three ticks, the ticks are evenly spaced instead.
    pub fn ticks(&self, max_ticks: usize) -> Vec<Tick> {
        match self.spacing {
            Spacing::Linear => self.evenly_spaced_ticks(max_ticks),
            Spacing::Logarithmic => self.power_of_ten_ticks(max_ticks),
        }
    }

    fn evenly_spaced_ticks(&self, max_ticks: usize) -> Vec<Tick> {
        let step =
            self.step.unwrap_or_else(|| round_step(self.hi - self.lo, max_ticks)).max(self.min_tick_distance);
        let decimals = usize::try_from(-(step.log10() + 1e-9).floor() as i32).unwrap_or_default();
        // The tolerance keeps a tick at an end of the scale, because the division rounds.
        let (first, last) = ((self.lo / step - 1e-6).ceil() as i64, (self.hi / step + 1e-6).floor() as i64);
        let tick = |number: i64| {
            let value = number as f64 * step;
            let text = if number == 0 { "0".to_owned() } else { fixed(value, decimals) };
            let sign = if self.has_plus_signs && number > 0 { "+" } else { "" };
            Tick { value, at: self.at(value), text: format!("{sign}{text}") }
        };
        (first..=last).map(tick).collect()
    }

    fn power_of_ten_ticks(&self, max_ticks: usize) -> Vec<Tick> {
        let decades = (self.lo.log10().floor() as i32)..=(self.hi.log10().ceil() as i32);
        let ticks_at = |factors: &'static [f64]| -> Vec<Tick> {
            let values = decades
                .clone()
                .flat_map(|decade| factors.iter().map(move |factor| factor * 10_f64.powi(decade)));
            let inside = values.filter(|value| self.has(*value));
            inside.map(|value| Tick { value, at: self.at(value), text: power_label(value) }).collect()
        };
        // A single mark, or two, would not show how values are spaced along the axis.
        let candidates = [ticks_at(&[1.0]), ticks_at(&[1.0, 2.0, 5.0])];
        let ticks = candidates.into_iter().find(|ticks| ticks.len() >= 3);
        let ticks = ticks.unwrap_or_else(|| self.evenly_spaced_ticks(max_ticks));
        // If there are too many powers of ten, only every second, third, … power has a tick.
        let step = ticks.len().div_ceil(2 * max_ticks.max(1)).max(1);
        ticks.into_iter().step_by(step).collect()
    }
}

/// Returns whether a linear scale from `lo` to `hi` would squeeze the small values, so that the scale should be
/// logarithmic.
pub(crate) fn is_wide((lo, hi): (f64, f64)) -> bool {
    lo > 0.0 && hi > lo * WIDE_RATIO
}

/// Limits a range to numbers whose differences and ratios are finite, so that loops along the range terminate.
fn clamp_to_finite_range((lo, hi): (f64, f64)) -> (f64, f64) {
    let clamp = |value: f64| {
        if value.abs() >= MIN_MAGNITUDE { value.clamp(-MAX_MAGNITUDE, MAX_MAGNITUDE) } else { 0.0 }
    };
    (clamp(lo), clamp(hi))
}

/// Returns a range with this value in its middle.
fn range_around(value: f64) -> (f64, f64) {
    let half = if value == 0.0 { 0.5 } else { value.abs() * 0.1 };
    (value - half, value + half)
}

/// Returns 1, 2 or 5 times a power of ten as text, without trailing zeros after the decimal point.
fn power_label(value: f64) -> String {
    let text = significant(value);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
