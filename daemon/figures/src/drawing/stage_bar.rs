//! Bar of the stages of one thing, with its values and with what is known of its total. Pages have it.

use peernet_analysis::slowness::BOTH_DIRECTIONS;
use peernet_statistics::number::{figure, fixed};

use super::stack::{Direction, Stack};
use crate::look::{INK_2, INK_3, Style, TextStyle, stage};
use crate::plot::{Anchor, At, Item, Label};
use crate::scale::Scale;

/// Upper and lower side of the bar, as shares of the height.
const BAR: (f64, f64) = (0.15, 0.85);
/// Height of the whiskers of clock bounds.
const BOUND: f64 = 0.08;
/// Share of the scale below which a clock bound is left out: it would look like the line between two stages.
const SEEN: f64 = 0.004;
/// Half the width of the caps of a clock bound and of the total's whisker, points.
const CAPS: (f64, f64) = (1.5, 3.8);

/// Length of a stage in a bar.
#[derive(Clone, Debug, PartialEq)]
pub struct StagePart {
    /// Name of the stage.
    pub name: String,
    /// Length, seconds.
    pub seconds: f64,
    /// Half width of the bound of its length, seconds; for one-way delays.
    pub bound: Option<f64>,
}

/// Stages in the order of their time, on a scale in ms.
#[derive(Clone, Debug, PartialEq)]
pub struct StageBar<'a> {
    /// Stages from the first to the last.
    pub parts: &'a [StagePart],
    /// Scale, ms.
    pub scale: Scale,
    /// True for lines at the marks of the scale.
    pub has_grid: bool,
    /// True for values and clock bounds, for which a low bar has no room.
    pub has_values: bool,
    /// Mean of the total and its standard deviation, seconds, which is drawn to both sides.
    pub spread: Option<(f64, f64)>,
    /// 95th and 99th percentile of the total, seconds.
    pub quantiles: [Option<f64>; 2],
}

impl<'a> StageBar<'a> {
    /// Returns a bar with its values and nothing about the total.
    pub fn new(parts: &'a [StagePart], scale: Scale) -> Self {
        Self { parts, scale, has_grid: true, has_values: true, spread: None, quantiles: [None; 2] }
    }

    /// Returns the bar of parts that fill it.
    pub fn whole(parts: &'a [StagePart]) -> Self {
        let end = parts.iter().map(|part| part.seconds.max(0.0)).sum::<f64>() * 1e3;
        let scale = if end > 0.0 { Scale::linear((0.0, end)) } else { Scale::up_to(0.0, 1) };
        Self { has_grid: false, ..Self::new(parts, scale) }
    }

    /// Lays it out.
    pub fn items(&self) -> Vec<Item> {
        let parts = self.parts.iter().filter(|part| part.seconds > 0.0);
        let parts = parts.map(|part| (part.name.as_str(), part.seconds * 1e3)).collect();
        let stack = Stack { parts, scale: self.scale };
        let mut items = if self.has_grid { Item::grid(&self.scale) } else { Vec::new() };
        items.extend(stack.items(BAR, Direction::Level));
        if self.has_values {
            items.extend(stack.segments().into_iter().map(|segment| Item::Text(self.value(segment))));
            items.extend(self.bounds(&stack));
        }
        let whisker = |ends| Direction::Level.rimmed_whisker(ends, [true; 2], CAPS.1);
        items
            .extend(self.spread_ends().into_iter().flat_map(|ends| whisker(ends.map(|at| At::new(at, 0.5)))));
        items.extend(self.whiskers(&stack));
        items
    }

    fn spread_ends(&self) -> Option<[f64; 2]> {
        let (mean, std) = self.spread?;
        Some([mean - std, mean + std].map(|seconds| self.scale.at(seconds * 1e3)))
    }

    /// Returns the value in a stage, with the stage's name where there is room; the total's whisker does not cross it.
    fn value(&self, (name, from, to): (&str, f64, f64)) -> Label {
        let (begin, end) = (self.scale.at(from), self.scale.at(to));
        let (middle, value) = (f64::midpoint(begin, end), to - from);
        let words = if (1.0..9.95).contains(&value) { fixed(value, 1) } else { figure(value) };
        let short = if name == BOTH_DIRECTIONS { "up + down" } else { name };
        let label = Label::new(At::new(middle, 0.5), words, stage(name).text()).anchored(Anchor::Middle);
        let label = label.led_by(format!("{short} ")).fits_within(end - begin);
        match self.spread_ends() {
            Some([left, right]) => label.fits_within(2.0 * (left - middle).max(middle - right).max(0.0)),
            None => label,
        }
    }

    /// Returns the clock bounds. The sum of both directions is exact: uncertain is where the other host's part begins and ends.
    fn bounds(&self, stack: &Stack<'_>) -> Vec<Item> {
        let whisker = |(name, from, to): (&str, f64, f64)| {
            let part = self.parts.iter().find(|part| part.name == name)?;
            let bound = part.bound?.min(part.seconds) * 1e3;
            let inner = if name == "download" { from } else { to };
            let ends = [inner - bound, inner + bound].map(|value| At::new(self.scale.at(value), BOUND));
            (ends[1].x - ends[0].x >= SEEN).then(|| Direction::Level.rimmed_whisker(ends, [true; 2], CAPS.0))
        };
        stack.segments().into_iter().filter_map(whisker).flatten().collect()
    }

    /// Returns whiskers from the bar's end: solid to the 95th percentile, dotted from there to the 99th.
    fn whiskers(&self, stack: &Stack<'_>) -> Vec<Item> {
        let solid = || Style::line("whisk", INK_2.light, 0.75);
        let dotted = Style::line("whisk far", INK_3.light, 0.75).dashed(Some((1.5, 1.5)));
        let looks = [(solid(), 0.16), (dotted, 0.1)];
        let mut items = Vec::new();
        let mut from = self.scale.at(stack.end());
        for (quantile, (line, half)) in self.quantiles.iter().zip(looks) {
            let Some(value) = quantile.map(|seconds| seconds * 1e3) else { continue };
            let to = self.scale.at(value);
            if to <= from {
                continue;
            }
            items.push(Item::line(At::new(from, 0.5), At::new(to, 0.5), line));
            items.push(if self.scale.has(value) {
                Item::line(At::new(to, 0.5 - half), At::new(to, 0.5 + half), solid())
            } else {
                Item::Text(Label::new(At::new(1.0, 0.5), "→", TextStyle::BEYOND).anchored(Anchor::End))
            });
            from = to;
        }
        items
    }
}
