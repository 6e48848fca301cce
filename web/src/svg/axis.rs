//! A linear scale from zero with round ticks.

use askama::Template;
use peernet_statistics::number::{SPACE, fixed};

use super::Percent;
use super::fit::{Fitted, width};

/// A label this near to an end of its plot, percent, would reach over it.
const END: f64 = 4.0;

/// Axis from zero to a round number above the largest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    max: f64,
    step: f64,
}

impl Scale {
    /// Returns a scale that holds values up to `largest` with about `ticks` steps of 1, 2 or 5 times a power of ten.
    pub(crate) fn fit(largest: f64, ticks: usize) -> Self {
        let largest = if largest.is_finite() && largest > 0.0 { largest } else { 1.0 };
        let rough = largest / ticks.max(1) as f64;
        let power = 10f64.powf(rough.log10().floor());
        let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough * 0.999);
        let step = factor.unwrap_or(10.0) * power;
        Self { max: (largest / step - 1e-9).ceil().max(1.0) * step, step }
    }

    /// Returns a scale that ends exactly at `largest`, for a bar that fills its panel and has no axis.
    pub(crate) fn whole(largest: f64) -> Self {
        let max = if largest.is_finite() && largest > 0.0 { largest } else { 1.0 };
        Self { max, step: max }
    }

    /// Returns whether a value lies on the scale.
    pub(crate) fn holds(&self, value: f64) -> bool {
        value <= self.max
    }

    /// Returns the position of a value; values beyond either end are placed at that end.
    pub(crate) fn at(&self, value: f64) -> Percent {
        Percent((value / self.max * 100.0).clamp(0.0, 100.0))
    }

    /// Returns the positions of the ticks.
    pub(crate) fn grid(&self) -> Vec<Percent> {
        self.values().map(|value| self.at(value)).collect()
    }

    /// Returns the positions and labels of the ticks of an axis that ends exactly at `end`.
    pub(crate) fn ticks_until(end: f64, ticks: usize) -> Vec<(Percent, String)> {
        let scale = Self::fit(end, ticks);
        let all = scale.values().zip(scale.labels());
        let held = all.filter(|(value, _)| *value <= end * (1.0 + 1e-9));
        held.map(|(value, text)| (Percent(value / end * 100.0), text)).collect()
    }

    fn values(&self) -> impl Iterator<Item = f64> + use<> {
        let Self { max, step } = *self;
        (0..=(max / step).round() as u32).map(move |tick| f64::from(tick) * step)
    }

    /// Returns the ticks' labels.
    pub(crate) fn labels(&self) -> Vec<String> {
        let decimals = (-self.step.log10().floor()).clamp(0.0, 6.0) as usize;
        self.values()
            .map(|value| if value == 0.0 { "0".to_owned() } else { fixed(value, decimals) })
            .collect()
    }
}

/// The labels of a scale, above the bars or below the plot that use it. Where they would touch every second one stays.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/axis.html")]
pub(crate) struct Axis {
    class: &'static str,
    labels: Vec<Label>,
}

impl askama::filters::HtmlSafe for Axis {}

#[derive(Clone, Debug, PartialEq)]
struct Label {
    x: Percent,
    anchor: &'static str,
    text: Fitted,
}

/// Returns the width that a label takes up on either side of its position, rem.
fn sides(text: &str, anchor: &str) -> [f64; 2] {
    match anchor {
        "start" => [0.0, width(text)],
        "end" => [width(text), 0.0],
        _ => [width(text) / 2.0; 2],
    }
}

impl Axis {
    /// Returns the labels in ms; `class` is `small` for the axis under a bar that only phones show.
    pub(crate) fn milliseconds(scale: &Scale, class: &'static str) -> Self {
        let positions = scale.grid();
        let last = positions.len().saturating_sub(1);
        let labels = positions.into_iter().zip(scale.labels()).enumerate();
        let labels = labels.map(|(index, (x, label))| match index {
            0 => (x, "start", format!("{label}{SPACE}ms")),
            _ if index == last => (x, "end", label),
            _ => (x, "middle", label),
        });
        Self::new(class, &labels.collect::<Vec<_>>())
    }

    /// Returns the labels below a plot, each in the middle below its tick.
    pub(crate) fn below(labels: Vec<(Percent, String)>) -> Self {
        let labels = labels.into_iter().map(|(x, text)| (x, "middle", text));
        Self::new("xaxis", &labels.collect::<Vec<_>>())
    }

    /// Returns labels below a plot that has no room at its sides: the labels at the ends are placed inside.
    pub(crate) fn within(labels: Vec<(Percent, String)>) -> Self {
        let anchor = |x: &Percent| match x.0 {
            left if left < END => "start",
            right if right > 100.0 - END => "end",
            _ => "middle",
        };
        let labels = labels.into_iter().map(|(x, text)| (x, anchor(&x), text));
        Self::new("xaxis", &labels.collect::<Vec<_>>())
    }

    fn new(class: &'static str, labels: &[(Percent, &'static str, String)]) -> Self {
        let fitted = labels.iter().enumerate().map(|(index, (x, anchor, text))| {
            // Each goes with all others that are divisible by the same power of two.
            let stride = if index == 0 { labels.len() } else { 1 << index.trailing_zeros() };
            let [left, right] = sides(text, anchor);
            let mut needs = Fitted::anywhere(text.clone());
            if let Some((other, anchor, text)) =
                index.checked_sub(stride).and_then(|before| labels.get(before))
            {
                needs.apart(x.0 - other.0, left + sides(text, anchor)[1]);
            }
            if let Some((other, anchor, text)) = labels.get(index + stride) {
                needs.apart(other.0 - x.0, right + sides(text, anchor)[0]);
            }
            Label { x: *x, anchor, text: needs }
        });
        Self { class, labels: fitted.collect() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(Scale::fit(25.7, 6).labels(), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(Scale::fit(0.37, 5).labels(), ["0", "0.1", "0.2", "0.3", "0.4"]);
        assert_eq!(Scale::fit(1_800.0, 4).labels(), ["0", "500", "1,000", "1,500", "2,000"]);
        assert_eq!(Scale::fit(0.0, 5).max, 1.0);
        assert_eq!(Scale::fit(f64::NAN, 5).max, 1.0);
    }

    #[test]
    fn an_axis_may_end_between_its_ticks() {
        let ticks = Scale::ticks_until(61.0, 4);
        assert_eq!(ticks.iter().map(|(_, text)| text.as_str()).collect::<Vec<_>>(), ["0", "20", "40", "60"]);
        assert!((ticks[3].0.0 - 6_000.0 / 61.0).abs() < 1e-9, "{ticks:?}");
    }

    impl Axis {
        /// Returns the labels that are shown in a picture of `width` rem.
        pub(crate) fn labels_at(&self, width: u16) -> Vec<&str> {
            let shown = self.labels.iter().filter_map(|label| label.text.shown());
            shown.filter(|(_, from)| *from <= width).map(|(text, _)| text).collect()
        }
    }

    #[test]
    fn labels_leave_before_they_touch() {
        let axis = Axis::milliseconds(&Scale::fit(1_200.0, 6), "");
        assert_eq!(axis.labels_at(30), ["0\u{202f}ms", "200", "400", "600", "800", "1,000", "1,200"]);
        assert_eq!(axis.labels_at(18), ["0\u{202f}ms", "200", "400", "600", "800", "1,200"]);
        assert_eq!(axis.labels_at(8), ["0\u{202f}ms", "400", "800"]);
        let even =
            Axis::below((1..=4).map(|n| (Percent(f64::from(n) * 20.0), format!("{n}00,000"))).collect());
        assert_eq!(even.labels_at(18), ["100,000", "200,000", "300,000", "400,000"]);
        assert_eq!(even.labels_at(12), ["100,000", "300,000"]);
    }

    #[test]
    fn labels_at_the_ends_of_a_small_plot_stand_inside() {
        let labels = [0.0, 50.0, 100.0].map(|x| (Percent(x), "0.04".to_owned()));
        let anchors = |axis: Axis| axis.labels.iter().map(|label| label.anchor).collect::<Vec<_>>();
        assert_eq!(anchors(Axis::within(labels.to_vec())), ["start", "middle", "end"]);
        assert_eq!(anchors(Axis::below(labels.to_vec())), ["middle"; 3]);
    }

    #[test]
    fn the_unit_stands_at_the_first_label() {
        let axis = Axis::milliseconds(&Scale::fit(30.0, 6), "").to_string();
        assert!(axis.contains(">0\u{202f}ms<"), "{axis}");
        assert!(axis.contains("x=\"100.000%\""), "{axis}");
    }

    proptest! {
        #[test]
        fn a_scale_holds_its_values_with_few_ticks(largest in 1e-6f64..1e9, ticks in 3usize..8) {
            let scale = Scale::fit(largest, ticks);
            prop_assert!(scale.max >= largest * 0.999_999);
            prop_assert!(scale.grid().len() <= ticks + 2);
            prop_assert!(scale.grid().len() >= 2);
        }
    }
}
