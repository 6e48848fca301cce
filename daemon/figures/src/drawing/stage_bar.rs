//! Bar of the stages of one iteration, run or configuration, with their values and the distribution of the total. In
//! files, [`Stacked`](super::Stacked) draws such bars.

use peernet_analysis::slowness::BOTH_DIRECTIONS;
use peernet_statistics::number::{figure, fixed};

use super::stack::{Orientation, Stack};
use crate::look::{INK_2, INK_3, Style, TextStyle, stage};
use crate::plot::{Anchor, At, Item, Label};
use crate::scale::Scale;

/// Vertical position of the whiskers of clock bounds, as a share of the picture's height from the top.
const BOUND_Y: f64 = 0.08;
/// Minimum length of the whisker of a clock bound, as a share of the scale. A shorter whisker would look like the line
/// between two stages.
const MIN_BOUND_LENGTH: f64 = 0.004;
/// Half the width of the caps of the whisker of a clock bound, points.
const BOUND_CAP_HALF_WIDTH: f64 = 1.5;

/// Place of a bar in its plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarPlace {
    /// Orientation of the scale.
    pub orientation: Orientation,
    /// Positions of both sides of the bar, as shares across the scale.
    pub sides: (f64, f64),
    /// Half the width of the caps of the total's whisker, points.
    pub cap_half_width: f64,
}

impl Default for BarPlace {
    /// Returns the place of a bar that is alone in its picture.
    fn default() -> Self {
        Self { orientation: Orientation::Horizontal, sides: (0.15, 0.85), cap_half_width: 3.8 }
    }
}

/// Stage in a bar.
#[derive(Clone, Debug, PartialEq)]
pub struct StagePart {
    /// Name of the stage.
    pub name: String,
    /// Length, seconds.
    pub seconds: f64,
    /// Half the width of the interval that contains the length according to the clock bounds, seconds; `None` for
    /// stages that are not one-way delays.
    pub bound: Option<f64>,
}

/// Bar of stages in the order of time, on a scale in ms.
#[derive(Clone, Debug, PartialEq)]
pub struct StageBar<'a> {
    /// Stages from the first to the last.
    pub parts: &'a [StagePart],
    /// Scale, ms.
    pub scale: Scale,
    /// True if grid lines are drawn at the marks of the scale.
    pub has_grid: bool,
    /// True if values and clock bounds are shown. A low bar has no room for values and bounds.
    pub has_values: bool,
    /// Mean and standard deviation of the total, seconds; `None` if they are not shown. A whisker extends by one
    /// standard deviation to both sides of the mean.
    pub mean_and_std: Option<(f64, f64)>,
    /// 95th and 99th percentile of the total, seconds; `None` for a percentile that is not shown.
    pub quantiles: [Option<f64>; 2],
    /// Place of the bar. A bar with values, clock bounds or percentiles must be alone in its picture and horizontal,
    /// because their positions do not depend on this place.
    pub place: BarPlace,
}

impl<'a> StageBar<'a> {
    /// Returns a bar with a grid and the values of its stages, but without the distribution of the total.
    pub fn new(parts: &'a [StagePart], scale: Scale) -> Self {
        Self {
            parts,
            scale,
            has_grid: true,
            has_values: true,
            mean_and_std: None,
            quantiles: [None; 2],
            place: BarPlace::default(),
        }
    }

    /// Returns a bar without a grid. The scale ends at the end of the last part, so that the parts fill the picture.
    pub fn full_width(parts: &'a [StagePart]) -> Self {
        let end = parts.iter().map(|part| part.seconds.max(0.0)).sum::<f64>() * 1e3;
        let scale = if end > 0.0 { Scale::linear((0.0, end)) } else { Scale::up_to(0.0, 1) };
        Self { has_grid: false, ..Self::new(parts, scale) }
    }

    /// Lays the bar out.
    pub fn items(&self) -> Vec<Item> {
        let parts = self.parts.iter().map(|part| (part.name.as_str(), part.seconds * 1e3)).collect();
        let stack = Stack { parts, scale: self.scale };
        let mut items = if self.has_grid { Item::grid(&self.scale) } else { Vec::new() };
        items.extend(stack.items(self.place.sides, self.place.orientation));
        if self.has_values {
            items.extend(stack.segments().into_iter().map(|segment| Item::Text(self.value_label(segment))));
            items.extend(self.bound_whiskers(&stack));
        }
        items.extend(self.total_whisker());
        items.extend(self.quantile_whiskers(&stack));
        items
    }

    /// Returns the whisker of the total. An end beyond the scale has no cap.
    fn total_whisker(&self) -> Vec<Item> {
        let Some((mean, std)) = self.mean_and_std else { return Vec::new() };
        let BarPlace { orientation, sides: (one_side, other_side), cap_half_width } = self.place;
        let values = [mean - std, mean + std].map(|seconds| seconds * 1e3);
        let ends =
            values.map(|value| orientation.at(self.scale.at(value), f64::midpoint(one_side, other_side)));
        orientation.rimmed_whisker(ends, values.map(|value| self.scale.has(value)), cap_half_width)
    }

    /// Returns the positions of both ends of the total's whisker.
    fn total_whisker_ends(&self) -> Option<[f64; 2]> {
        let (mean, std) = self.mean_and_std?;
        Some([mean - std, mean + std].map(|seconds| self.scale.at(seconds * 1e3)))
    }

    /// Returns the label of a stage: the value, and before the value the name of the stage if there is room. The label
    /// is hidden if the whisker of the total would cross the label.
    fn value_label(&self, (name, from, to): (&str, f64, f64)) -> Label {
        let (begin, end) = (self.scale.at(from), self.scale.at(to));
        let (middle, value) = (f64::midpoint(begin, end), to - from);
        // From 1 to 10 ms, `figure` would give a second decimal, for which a label has little room.
        let value_text = if (1.0..10.0).contains(&value) { fixed(value, 1) } else { figure(value) };
        let short_name = if name == BOTH_DIRECTIONS { "up + down" } else { name };
        let label = Label::new(At::new(middle, 0.5), value_text, stage(name).text()).anchored(Anchor::Middle);
        let label = label.with_prefix(format!("{short_name} ")).with_max_width(end - begin);
        match self.total_whisker_ends() {
            // A label on one side of the whisker may be at most twice as wide as its middle is away from the whisker. A
            // label whose middle is under the whisker has no room.
            Some([left, right]) => label.with_max_width(2.0 * (left - middle).max(middle - right).max(0.0)),
            None => label,
        }
    }

    /// Returns the whiskers of the clock bounds. The sum of both directions is exact, but the boundaries between the
    /// network and the stages on the cloud are uncertain. The whiskers are therefore at the end of the upload and at
    /// the beginning of the download.
    fn bound_whiskers(&self, stack: &Stack<'_>) -> Vec<Item> {
        let whisker = |(name, from, to): (&str, f64, f64)| {
            let part = self.parts.iter().find(|part| part.name == name)?;
            // Each side of the whisker is at most as long as the delay, because a delay is not negative.
            let bound = part.bound?.min(part.seconds) * 1e3;
            let boundary = if name == "download" { from } else { to };
            let ends =
                [boundary - bound, boundary + bound].map(|value| At::new(self.scale.at(value), BOUND_Y));
            (ends[1].x - ends[0].x >= MIN_BOUND_LENGTH)
                .then(|| Orientation::Horizontal.rimmed_whisker(ends, [true; 2], BOUND_CAP_HALF_WIDTH))
        };
        stack.segments().into_iter().filter_map(whisker).flatten().collect()
    }

    /// Returns the whiskers after the end of the bar: a solid line to the 95th percentile, and a dotted line from the
    /// 95th to the 99th percentile. A percentile beyond the scale has an arrow.
    fn quantile_whiskers(&self, stack: &Stack<'_>) -> Vec<Item> {
        let solid = || Style::line("whisk", INK_2.light, 0.75);
        let dotted = Style::line("whisk far", INK_3.light, 0.75).dashed(Some((1.5, 1.5)));
        // Style of each line, and half the height of the mark at its end.
        let looks = [(solid(), 0.16), (dotted, 0.1)];
        let mut items = Vec::new();
        let mut from = self.scale.at(stack.end());
        for (quantile, (line, half_height)) in self.quantiles.iter().zip(looks) {
            let Some(value) = quantile.map(|seconds| seconds * 1e3) else { continue };
            let to = self.scale.at(value);
            if to <= from {
                continue;
            }
            items.push(Item::line(At::new(from, 0.5), At::new(to, 0.5), line));
            items.push(if self.scale.has(value) {
                Item::line(At::new(to, 0.5 - half_height), At::new(to, 0.5 + half_height), solid())
            } else {
                Item::Text(Label::new(At::new(1.0, 0.5), "→", TextStyle::BEYOND).anchored(Anchor::End))
            });
            from = to;
        }
        items
    }
}
