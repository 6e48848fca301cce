//! The axis across: linear, or logarithmic where the values span more than a decade.

use peernet_statistics::number::fixed;

use super::{Percent, Ruler, Scale};

/// Times the smallest value from which on the axis is logarithmic.
const DECADE: f64 = 10.0;
/// Decades from which on only powers of ten have a tick.
const MANY: f64 = 2.5;

/// Horizontal axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Horizontal {
    /// Linear from zero.
    Linear(Scale),
    /// Linear from a value other than zero.
    Between(Ruler),
    /// Logarithmic from one value to another, both above zero.
    Logarithmic(f64, f64),
}

impl Horizontal {
    /// Returns an axis that holds all values.
    pub(crate) fn of(values: impl Iterator<Item = f64>) -> Self {
        let (least, most) = values.fold((f64::INFINITY, 0.0_f64), |(lo, hi), x| (lo.min(x), hi.max(x)));
        if least > 0.0 && most > least * DECADE && most.is_finite() {
            // Room for the names at both ends.
            let room = (most / least).powf(0.06);
            return Self::Logarithmic(least / room, most * room);
        }
        Self::Linear(Scale::fit(most * 1.02, 6))
    }

    /// Returns an axis from one value to another, with about `ticks` ticks where it is linear.
    pub(crate) fn around(lo: f64, hi: f64, ticks: usize) -> Self {
        if lo > 0.0 && hi > lo * DECADE && hi.is_finite() {
            return Self::Logarithmic(lo, hi);
        }
        Self::Between(Ruler::around(lo, hi, ticks))
    }

    /// Returns an axis that holds all of these whole numbers, with ticks at whole numbers only.
    pub(crate) fn of_numbers(values: impl Iterator<Item = f64> + Clone) -> Self {
        let most = values.clone().fold(0.0, f64::max);
        match Self::of(values) {
            Self::Linear(_) => Self::Linear(Scale::fit(most + 0.5, (most as usize + 1).min(6))),
            other => other,
        }
    }

    /// Returns whether equal distances are equal factors.
    pub(crate) const fn is_logarithmic(&self) -> bool {
        matches!(self, Self::Logarithmic(..))
    }

    /// Returns the position of a value.
    pub(crate) fn at(&self, value: f64) -> Percent {
        match self {
            Self::Linear(scale) => scale.at(value),
            Self::Between(ruler) => Percent((1.0 - ruler.below(value)) * 100.0),
            Self::Logarithmic(lo, hi) => {
                let share = (value.max(*lo) / lo).ln() / (hi / lo).ln();
                Percent((share * 100.0).clamp(0.0, 100.0))
            }
        }
    }

    /// Returns the value at this share of the way between two values.
    pub(crate) fn between(&self, from: f64, to: f64, share: f64) -> f64 {
        if self.is_logarithmic() && from > 0.0 {
            from * (to / from).powf(share)
        } else {
            from + (to - from) * share
        }
    }

    /// Returns the positions and labels of the ticks.
    pub(crate) fn ticks(&self) -> Vec<(Percent, String)> {
        let (lo, hi) = match self {
            Self::Linear(scale) => return scale.grid().into_iter().zip(scale.labels()).collect(),
            Self::Between(ruler) => {
                return ruler
                    .ticks()
                    .into_iter()
                    .map(|(below, text)| (Percent(100.0 - below.0), text))
                    .collect();
            }
            Self::Logarithmic(lo, hi) => (*lo, *hi),
        };
        let factors: &[f64] = if (hi / lo).log10() > MANY { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let powers = lo.log10().floor() as i32..=hi.log10().ceil() as i32;
        let values =
            powers.flat_map(|power| factors.iter().map(move |factor| (factor * 10f64.powi(power), power)));
        let held = values.filter(|(value, _)| (lo..=hi).contains(value));
        held.map(|(value, power)| (self.at(value), fixed(value, (-power).clamp(0, 9) as usize))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(values: &[f64]) -> Vec<String> {
        Horizontal::of(values.iter().copied()).ticks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn only_what_spans_a_decade_is_logarithmic() {
        assert_eq!(labels(&[10.0, 50.0, 100.0]), ["0", "20", "40", "60", "80", "100", "120"]);
        assert_eq!(labels(&[8.0, 30.0, 100.0]), ["10", "20", "50", "100"]);
        assert_eq!(labels(&[0.1, 30.0, 1_000.0]), ["0.1", "1", "10", "100", "1,000"]);
        assert!(!Horizontal::of([0.0, 1e6].into_iter()).is_logarithmic(), "zero has no logarithm");
        assert!(!Horizontal::of(std::iter::empty()).ticks().is_empty());
    }

    #[test]
    fn numbers_have_whole_ticks_beyond_the_largest() {
        let labels = |most: u32| {
            let values = (1..=most).map(f64::from);
            Horizontal::of_numbers(values).ticks().into_iter().map(|(_, text)| text).collect::<Vec<_>>()
        };
        assert_eq!(labels(1), ["0", "1", "2"]);
        assert_eq!(labels(3), ["0", "1", "2", "3", "4"]);
        assert_eq!(labels(8), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(64), ["1", "2", "5", "10", "20", "50"]);
    }
}
