//! Bar of consecutive stages along a scale, for pages and files.

use crate::look::{Style, stage};
use crate::plot::{At, Item};
use crate::scale::Scale;

/// Minimum length of a part in a file, points, so that a short part is visible.
const MIN_LENGTH: f64 = 0.6;
/// No line separates a part from the part before it if the part is shorter than this share of the scale, because the
/// line would hide the part.
const MIN_SEPARATED_SHARE: f64 = 0.006;

/// Orientation of a bar or of a whisker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// From bottom to top.
    Vertical,
    /// From left to right.
    Horizontal,
}

impl Orientation {
    /// Returns the place at a share along the scale and a share across the scale. The share across the scale is
    /// measured from the left or from the top.
    pub fn at(self, along: f64, across: f64) -> At {
        match self {
            Self::Vertical => At::new(across, 1.0 - along),
            Self::Horizontal => At::new(along, across),
        }
    }

    /// Returns a whisker along the scale. `has_cap` says which of its two ends have a cap. A cap extends `cap` points
    /// to each side.
    pub fn whisker(self, ends: [At; 2], has_cap: [bool; 2], cap: f64, style: &Style) -> Vec<Item> {
        if self == Self::Vertical {
            return Item::whisker(ends, has_cap, cap, style);
        }
        let mut items = vec![Item::line(ends[0], ends[1], style.clone())];
        for (end, _) in ends.into_iter().zip(has_cap).filter(|(_, has_cap)| *has_cap) {
            items.push(Item::line(end.offset_by(0.0, -cap), end.offset_by(0.0, cap), style.clone()));
        }
        items
    }

    /// Returns a [whisker](Self::whisker) with a rim in the colour of the background.
    pub fn rimmed_whisker(self, ends: [At; 2], has_cap: [bool; 2], cap: f64) -> Vec<Item> {
        [Style::halo(), Style::whisker()]
            .iter()
            .flat_map(|style| self.whisker(ends, has_cap, cap, style))
            .collect()
    }
}

/// Bar of consecutive parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Stack<'a> {
    /// Stage and value of each part, in the order of time. Values are in the unit of the scale. A value may be negative
    /// if the clocks are not related. Negative parts lie below zero.
    pub parts: Vec<(&'a str, f64)>,
    /// Scale of the values.
    pub scale: Scale,
}

impl Stack<'_> {
    /// Returns the sum of the parts above zero.
    pub fn end(&self) -> f64 {
        self.parts.iter().map(|(_, value)| value.max(0.0)).sum()
    }

    /// Returns the name, the start and the end of each part that is not zero, in the unit of the scale. Negative parts
    /// are stacked from zero downwards.
    pub fn segments(&self) -> Vec<(&str, f64, f64)> {
        let (mut negative_end, mut positive_end) = (0.0, 0.0);
        let parts = self.parts.iter().filter(|(_, value)| *value != 0.0);
        let segment = |(name, value): &(_, f64)| {
            let end = if *value < 0.0 { &mut negative_end } else { &mut positive_end };
            let from = *end;
            *end += value;
            (*name, from, *end)
        };
        parts.map(segment).collect()
    }

    /// Lays the parts out in a bar. `sides` are the positions of both sides of the bar across the scale.
    pub fn items(&self, sides: (f64, f64), orientation: Orientation) -> Vec<Item> {
        let (one_side, other_side) = sides;
        let mut items = Vec::new();
        let min_size =
            if orientation == Orientation::Vertical { (0.0, MIN_LENGTH) } else { (MIN_LENGTH, 0.0) };
        for (name, from, to) in self.segments() {
            let [begin, end] = [from, to].map(|value| self.scale.at(value));
            let corners = [orientation.at(begin, one_side), orientation.at(end, other_side)];
            items.push(Item::Rect { from: corners[0], to: corners[1], min_size, style: stage(name).area() });
            // Neighbouring parts can have the same colour, so a line separates them.
            if from != 0.0 && (end - begin).abs() > MIN_SEPARATED_SHARE {
                items.push(Item::line(
                    orientation.at(begin, one_side),
                    orientation.at(begin, other_side),
                    Style::cut(),
                ));
            }
        }
        items
    }
}
