//! A linear scale between any two values, with round ticks.

use peernet_statistics::number::fixed;

use super::Percent;

/// Axis from one round number to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ruler {
    lo: f64,
    hi: f64,
    step: f64,
    signed: bool,
}

/// 1, 2 or 5 times a power of ten, so that `span` holds about `ticks` of it.
fn round_step(span: f64, ticks: usize) -> f64 {
    let rough = span / ticks.max(1) as f64;
    let power = 10f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough * 0.999);
    factor.unwrap_or(10.0) * power
}

fn or_one(size: f64) -> f64 {
    if size.is_finite() && size > 0.0 { size } else { 1.0 }
}

impl Ruler {
    /// Returns an axis that holds the values from `lo` to `hi`.
    pub(crate) fn around(lo: f64, hi: f64, ticks: usize) -> Self {
        let (lo, hi) = if lo.is_finite() && hi.is_finite() { (lo.min(hi), lo.max(hi)) } else { (0.0, 1.0) };
        // A narrower axis would need labels with more digits than people read.
        let least = (lo.abs().max(hi.abs()) * 1e-9).max(1e-6);
        let (lo, hi) = if hi - lo < least { (lo - least, hi + least) } else { (lo, hi) };
        let step = round_step(hi - lo, ticks);
        let (lo, hi) = ((lo / step + 1e-9).floor() * step, (hi / step - 1e-9).ceil() * step);
        Self { lo, hi, step, signed: false }
    }

    /// Returns an axis that holds the values from zero to `largest`.
    pub(crate) fn from_zero(largest: f64, ticks: usize) -> Self {
        Self::around(0.0, or_one(largest), ticks)
    }

    /// Returns an axis that holds values up to `largest` on both sides of zero; its labels carry their sign.
    pub(crate) fn both_sides(largest: f64, ticks: usize) -> Self {
        let largest = or_one(largest);
        Self { signed: true, ..Self::around(-largest, largest, ticks) }
    }

    /// Writes a sign before every label.
    pub(crate) fn signed(self) -> Self {
        Self { signed: true, ..self }
    }

    /// Returns whether a value lies between its ends.
    pub(crate) fn holds(&self, value: f64) -> bool {
        (self.lo..=self.hi).contains(&value)
    }

    /// Returns the upper end.
    pub(crate) fn end(&self) -> f64 {
        self.hi
    }

    /// Returns the upper end as its tick names it, without a sign.
    pub(crate) fn end_label(&self) -> String {
        self.label(self.hi)
    }

    fn label(&self, value: f64) -> String {
        let decimals = (-self.step.log10() - 1e-9).ceil().clamp(0.0, 9.0) as usize;
        if value.abs() < self.step * 1e-6 { "0".to_owned() } else { fixed(value, decimals) }
    }

    /// Returns the distance of a value from the upper end, as a share of the whole; values beyond an end are placed slightly outside of
    /// it.
    pub(crate) fn below(&self, value: f64) -> f64 {
        ((self.hi - value) / (self.hi - self.lo)).clamp(-0.05, 1.05)
    }

    /// Returns the positions from above and labels of the ticks.
    pub(crate) fn ticks(&self) -> Vec<(Percent, String)> {
        let count = ((self.hi - self.lo) / self.step).round().clamp(1.0, 50.0) as u32;
        let ticks = (0..=count).map(|tick| {
            let value = self.lo + f64::from(tick) * self.step;
            let text = self.label(value);
            let plus = if self.signed && value > 0.0 && text != "0" { "+" } else { "" };
            (Percent(self.below(value) * 100.0), format!("{plus}{text}"))
        });
        ticks.collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn labels(ruler: Ruler) -> Vec<String> {
        ruler.ticks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round_and_signed_where_they_must_be() {
        assert_eq!(labels(Ruler::from_zero(14.2, 3)), ["0", "5", "10", "15"]);
        assert_eq!(
            labels(Ruler::both_sides(2.4, 6)),
            ["\u{2212}3", "\u{2212}2", "\u{2212}1", "0", "+1", "+2", "+3"]
        );
        assert_eq!(
            labels(Ruler::around(1_203.53, 1_204.83, 3)),
            ["1,203.5", "1,204.0", "1,204.5", "1,205.0"]
        );
        assert_eq!(Ruler::both_sides(0.0123, 6).end_label(), "0.015");
        assert_eq!(
            labels(Ruler::from_zero(0.0, 2)),
            ["0.0", "0.5", "1.0"].map(|text| if text == "0.0" { "0" } else { text })
        );
    }

    #[test]
    fn nothing_and_nonsense_still_make_a_scale() {
        for ruler in
            [Ruler::around(f64::NAN, 1.0, 3), Ruler::around(5.0, 5.0, 3), Ruler::from_zero(f64::INFINITY, 3)]
        {
            assert!(ruler.hi > ruler.lo && ruler.ticks().len() >= 2, "{ruler:?}");
        }
    }

    proptest! {
        #[test]
        fn a_ruler_holds_its_values_with_few_ticks(lo in -1e6f64..1e6, width in 1e-3f64..1e6, ticks in 2usize..7) {
            let ruler = Ruler::around(lo, lo + width, ticks);
            prop_assert!(ruler.lo <= lo + width * 1e-6 && ruler.hi >= lo + width * (1.0 - 1e-6));
            prop_assert!((2..=ticks + 3).contains(&ruler.ticks().len()), "{:?}", ruler.ticks());
            prop_assert!((0.0..=1.0).contains(&ruler.below(lo + width / 2.0)));
        }
    }
}
