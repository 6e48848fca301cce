//! Pictures on pages: layouts of `peernet-figures` as HTML.

use std::fmt;

use peernet_figures::plot::{Item, Key, Plot};
use peernet_figures::render::page;
use peernet_figures::scale::{Scale, Tick};
use peernet_statistics::number::SPACE;

/// HTML of a picture, in which all text is escaped.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Picture(String);

impl fmt::Display for Picture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl askama::filters::HtmlSafe for Picture {}

impl Picture {
    /// Draws items without axes. `label` describes the items in words; it is empty if numbers next to the picture contain the same
    /// information.
    pub(crate) fn of_items(items: &[Item], class: &str, label: &str) -> Self {
        Self(page::picture(items, class, label))
    }

    /// Draws a plot with its axes. `class` names the layout of the plot in the style sheet, and `label` describes the plot in words.
    pub(crate) fn of_plot(plot: &Plot, class: &str, label: &str) -> Self {
        Self(page::plot(plot, class, label))
    }

    /// Draws a legend.
    pub(crate) fn of_legend(keys: &[Key], class: &str) -> Self {
        Self(page::legend(keys, class))
    }

    /// Draws the labels of a scale in ms. The first label has the unit. `class` is `small` for the axis under a single bar; only
    /// narrow screens show such an axis.
    pub(crate) fn milliseconds_axis(scale: &Scale, class: &str) -> Self {
        let mut ticks = scale.ticks(6);
        if let Some(first) = ticks.first_mut() {
            first.text.push_str(SPACE);
            first.text.push_str("ms");
        }
        Self(page::axis_within(class, &ticks))
    }

    /// Draws labels at the left side of a picture.
    pub(crate) fn labels_beside(class: &str, ticks: &[Tick]) -> Self {
        Self(page::y_labels(class, ticks))
    }

    /// Draws labels below a picture, each in the middle below its tick.
    pub(crate) fn labels_below(class: &str, ticks: &[Tick]) -> Self {
        Self(page::axis(class, ticks))
    }

    /// Draws the labels of a scale below a picture that has no room at its sides.
    pub(crate) fn axis_below(scale: &Scale) -> Self {
        Self(page::axis_within("xaxis", &scale.ticks(5)))
    }

    /// Appends another picture.
    pub(crate) fn followed_by(mut self, next: &Self) -> Self {
        self.0.push_str(&next.0);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_label_of_axis_has_the_unit() {
        let axis = Picture::milliseconds_axis(&Scale::up_to(30.0, 6), "").to_string();
        assert!(axis.contains(">0\u{202f}ms<") && axis.contains("x=\"100%\""), "{axis}");
        assert_eq!(
            axis.matches("text-anchor=\"middle\"").count(),
            5,
            "only the labels between both ends are centred at their ticks: {axis}"
        );
    }
}
