//! Figure of one quantity at several placements: the same model on the robot and in the cloud, side by side.

mod density;

use peernet_statistics::number::{counted, fixed, range_of_counts, significant};

use super::histogram::shown_range_of;
use crate::look::{Fill, INK_2, Style, TextStyle, WHITE, series};
use crate::plot::{Anchor, At, Axis, Figure, Item, Key, Label, Marks, Path, Plot, Swatch, Unit};
use crate::render::file::{SMALL, TEXT};
use crate::scale::{Scale, Tick};
use crate::text::{shorten_distinctly, width};
use density::density;
use peernet_analysis::order::SortedValues;

/// Approximate width of the plot in a file, points.
const PLOT_WIDTH: f64 = 213.0;
/// Half the width of the bar between the quartiles, points.
const BAR_HALF_WIDTH: f64 = 1.2;
/// Width of the rim around the bar, points.
const RIM: f64 = 0.5;
/// Radius of a point, points.
const RADIUS: f64 = 1.8;
/// Maximum of half the width of a shape, as a share of the plot's width.
const MAX_HALF_WIDTH: f64 = 0.09;
/// Margin above the largest value, for the text at the top. On a linear axis, the margin is this share of the largest
/// value. On a logarithmic axis, the margin is a factor: the ratio of the largest to the smallest value to this power.
const MARGIN_ABOVE: f64 = 0.12;
/// Distance from the plot to the baseline of the counts, points.
const COUNT_DISTANCE: f64 = 9.5;
/// Share of the width of a group that its placements take. The rest stays free on both sides of the group.
const PLACEMENTS_SHARE: f64 = 0.9;
/// Minimum distance between two counts or between two names side by side, points.
const TEXT_DISTANCE: f64 = 1.8;
/// Maximum number of values that are drawn as points. A larger number of values is drawn as a shape.
const MAX_POINTS: usize = 60;
/// Points above the shown range are drawn up to this multiple of the end of the range, because there is room for them
/// below the text at the top.
const ROOM_FOR_POINTS: f64 = 1.05;
/// The axis is logarithmic if the ratio of the largest to the smallest median is at least this.
const LOGARITHMIC_RATIO: f64 = 30.0;
/// Maximum number of placements whose distributions a reader can distinguish.
pub const MAX_PLACEMENTS: usize = 4;
/// Maximum number of groups that fit into a figure as wide as a column.
pub const MAX_GROUPS: usize = 12;

/// Distributions side by side, in groups. The distributions of a group are those of a model at each placement.
#[derive(Clone, Debug, PartialEq)]
pub struct Paired {
    /// Title of the figure.
    pub title: String,
    /// Unit of the vertical axis.
    pub unit: Unit,
    /// Names of the placements in the order of the distributions in each group, at most [`MAX_PLACEMENTS`].
    pub placements: Vec<String>,
    /// One group for each model, at most [`MAX_GROUPS`].
    pub groups: Vec<Group>,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Group of one model.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Name of the model.
    pub name: String,
    /// Values at each placement, SI units. A placement without values has an empty list.
    pub values: Vec<SortedValues>,
}

impl Group {
    /// Returns the ratio of the median at the first placement to the median at the second placement, such as `2.5 ×`;
    /// `None` unless there are two placements.
    fn ratio(&self) -> Option<String> {
        let [first, second] = self.values.as_slice() else { return None };
        let (first, second) = (first.median()?, second.median()?);
        (first > 0.0 && second > 0.0).then(|| format!("{} ×", significant(first / second)))
    }
}

impl Paired {
    /// Returns sentences on how to read the figure.
    fn reading_notes(&self) -> Vec<String> {
        let mut notes = self.notes.clone();
        if !self.has_room_for_counts() {
            // The figure does not show the counts, so the notes give their range.
            let counts = self.groups.iter().flat_map(|group| &group.values).map(|values| values.len() as u64);
            notes.extend(range_of_counts(counts.filter(|n| *n > 0)).map(|n| format!("n = {n} each")));
        }
        let has_points = |values: &SortedValues| !values.is_empty() && self.is_drawn_as_points(values);
        if self.groups.iter().flat_map(|group| &group.values).any(has_points) {
            notes.push(format!(
                "up to {MAX_POINTS} values: each value is a point, moved sideways so that no point hides another; the \
                 black mark among the points is the median"
            ));
        }
        if self.groups.iter().any(|group| group.ratio().is_some()) {
            notes.push(format!("above a pair: median {} ÷ {}", self.placements[0], self.placements[1]));
        }
        if self.groups.iter().flat_map(|group| &group.values).any(|values| self.count_above(values) > 0) {
            notes.push("+ and a number: number of higher values that are not drawn".to_owned());
        }
        let below = self
            .groups
            .iter()
            .flat_map(|group| &group.values)
            .map(|values| self.count_below(values))
            .sum::<usize>();
        if below > 0 {
            notes.push(format!("not drawn: {}", counted(below as u64, "lower value")));
        }
        notes
    }

    /// Returns whether there is room for the count below each distribution.
    fn has_room_for_counts(&self) -> bool {
        let placements = self.groups.iter().map(|group| group.values.len()).max().unwrap_or(1);
        let max_width =
            PLOT_WIDTH * PLACEMENTS_SHARE / (self.groups.len() * placements).max(1) as f64 - TEXT_DISTANCE;
        let mut distributions = self.groups.iter().flat_map(|group| &group.values);
        distributions.all(|values| width(&count_text(values), SMALL) <= max_width)
    }

    /// Returns the range of values that the axis must show: all distributions, except tails that would leave little
    /// space for the rest. `None` without finite values.
    fn shown_range(&self) -> Option<(f64, f64)> {
        let ends = |values: &SortedValues| {
            let (lo, hi) = shown_range_of(values)?;
            // If values are drawn as points and all values are above zero, the axis shows the smallest value, even if
            // it is far below the other values.
            let smallest = values.values().first().copied().filter(|smallest| *smallest > 0.0);
            Some((smallest.filter(|_| values.len() <= MAX_POINTS).unwrap_or(lo), hi))
        };
        let ranges = self.groups.iter().flat_map(|group| &group.values).filter_map(ends);
        ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).filter(|(lo, hi)| lo.is_finite() && hi.is_finite())
    }

    /// Returns whether the axis is logarithmic, because most values would lie at the lower end of a linear axis.
    fn is_logarithmic(&self) -> bool {
        let medians = self.groups.iter().flat_map(|group| &group.values).filter_map(SortedValues::median);
        let medians: SortedValues = medians.collect();
        let ends = medians.values().first().zip(medians.values().last());
        self.shown_range().is_some_and(|(lo, _)| lo > 0.0)
            && ends.is_some_and(|(lo, hi)| *hi >= LOGARITHMIC_RATIO * lo)
    }

    /// Returns the largest of these values that is drawn. If there are few values, this is the largest value that fits
    /// on the axis. If there are more than [`MAX_POINTS`] values, this is the largest value that is not in the far
    /// tail.
    fn largest_drawn(&self, values: &SortedValues) -> Option<f64> {
        let (_, hi) = shown_range_of(values)?;
        if values.len() > MAX_POINTS {
            return Some(hi);
        }
        let (_, end) = self.shown_range()?;
        values.values().iter().rev().copied().find(|value| *value <= end * ROOM_FOR_POINTS)
    }

    /// Returns the number of values above the largest value that is drawn.
    fn count_above(&self, values: &SortedValues) -> usize {
        let count = |largest| values.values().iter().filter(|value| **value > largest).count();
        self.largest_drawn(values).map_or(0, count)
    }

    /// Returns the number of values below the smallest value that is drawn.
    fn count_below(&self, values: &SortedValues) -> usize {
        let shown_range = if values.len() > MAX_POINTS { shown_range_of(values) } else { self.shown_range() };
        let count = |(smallest, _)| values.values().iter().filter(|value| **value < smallest).count();
        shown_range.map_or(0, count)
    }

    /// Returns the outline of a distribution: values, each with its density from 0 to 1. The outline is empty if all
    /// values are equal.
    fn outline(&self, values: &SortedValues) -> Vec<(f64, f64)> {
        let Some(ends) = shown_range_of(values) else { return Vec::new() };
        if self.is_logarithmic() { log_density(values, ends) } else { density(values, ends) }
    }

    /// Returns whether the values are drawn as points and not as a shape.
    fn is_drawn_as_points(&self, values: &SortedValues) -> bool {
        values.len() <= MAX_POINTS || self.outline(values).len() <= 1
    }

    /// Returns the items of one distribution. `placement` is the index of its placement, `middle` is its horizontal
    /// position, and `half_width` is half of its maximum width. Position and width are shares of the plot's width.
    fn distribution_items(
        &self,
        plot: &Plot,
        values: &SortedValues,
        placement: usize,
        (middle, half_width): (f64, f64),
    ) -> Vec<Item> {
        let look = series(placement);
        let y = |value: f64| plot.y_share(value * self.unit.per_si);
        let Some((lo, _)) = shown_range_of(values) else { return Vec::new() };
        let largest_drawn = self.largest_drawn(values);
        let mut items = Vec::new();
        if !self.is_drawn_as_points(values) {
            let outline = self.outline(values);
            let edge = |sign: f64| {
                outline.iter().map(move |(value, density)| (middle + sign * half_width * density, y(*value)))
            };
            let corners: Vec<(f64, f64)> =
                edge(1.0).chain(edge(-1.0).collect::<Vec<_>>().into_iter().rev()).collect();
            items.push(Item::path(Path::polygon(corners), look.shape()));
        } else {
            let smallest_drawn = self.shown_range().map_or(lo, |(smallest, _)| smallest);
            let is_shown = |value: &&f64| {
                **value >= smallest_drawn && largest_drawn.is_some_and(|largest| **value <= largest)
            };
            for (index, value) in values.values().iter().filter(is_shown).enumerate() {
                // Multiples of the golden ratio move consecutive points far apart sideways, so that each point is
                // visible. Unlike random offsets, these offsets are the same each time.
                let offset = (index as f64 * 0.618_034).fract() - 0.5;
                let at = At::new(middle + offset * half_width, y(*value));
                items.push(Item::mark(at, look.mark, RADIUS, look.shape()));
            }
        }
        // Quartiles of fewer than four values would say little.
        if values.len() >= 4
            && let Some((low, high)) = values.quantile(0.25).zip(values.quantile(0.75))
        {
            let bar = |margin: f64, style: Style| {
                let (from, to) = (At::new(middle, y(high)), At::new(middle, y(low)));
                Item::rect(
                    from.offset_by(-BAR_HALF_WIDTH - margin, -margin),
                    to.offset_by(BAR_HALF_WIDTH + margin, margin),
                    style,
                )
            };
            items.push(bar(RIM, Style::area("rim", Fill::of(WHITE))));
            items.push(bar(0.0, Style::area("quartiles", Fill::of(INK_2.light))));
        }
        if let Some(median) = values.median() {
            let at = At::new(middle, y(median));
            items.push(Item::mark(at, look.mark, RADIUS + RIM, Style::area("rim", Fill::of(WHITE))));
            items.push(Item::mark(at, look.mark, RADIUS, Style::ink()));
        }
        let above = self.count_above(values);
        if let Some(largest) = largest_drawn.filter(|_| above > 0) {
            // The label must not touch the highest point. The shift 0 puts the baseline of the
            // label, instead of its middle, 3 points above the centre of this point.
            let at = At::new(middle, y(largest)).offset_by(0.0, -3.0);
            let label = Label::new(at, format!("+{}", fixed(above as f64, 0)), TextStyle::BEYOND);
            items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, 0.0)));
        }
        items
    }
}

/// Returns values between `lo` and `hi`, each with the density of its logarithm. This density is the width of the shape
/// on a logarithmic axis.
fn log_density(values: &SortedValues, (lo, hi): (f64, f64)) -> Vec<(f64, f64)> {
    let logarithms: SortedValues =
        values.values().iter().filter(|value| **value > 0.0).map(|value| value.ln()).collect();
    density(&logarithms, (lo.ln(), hi.ln()))
        .into_iter()
        .map(|(logarithm, density)| (logarithm.exp(), density))
        .collect()
}

/// Returns the number of values as text, such as `n = 1,200`.
fn count_text(values: &SortedValues) -> String {
    format!("n = {}", fixed(values.len() as f64, 0))
}

impl Paired {
    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let key = |(index, name): (usize, &String)| {
            let look = series(index);
            Key::new(Swatch::Curve(look.shape(), look.mark, Style::ink()), name.clone())
        };
        Figure {
            title: self.title.clone(),
            legend: self.placements.iter().enumerate().map(key).collect(),
            notes: self.reading_notes(),
            plots: self.shown_range().map(|shown| self.plot(shown)).into_iter().collect(),
            ..Figure::default()
        }
    }

    fn scale(&self, (lo, hi): (f64, f64)) -> Scale {
        let (lo, hi) = (lo * self.unit.per_si, hi * self.unit.per_si);
        if self.is_logarithmic() {
            // Below the values there is no text, so a smaller margin is enough.
            let margin = (hi / lo).powf(MARGIN_ABOVE);
            Scale::logarithmic((lo / margin.sqrt(), hi * margin))
        } else {
            Scale::from_zero((lo, hi * (1.0 + MARGIN_ABOVE)))
        }
    }

    fn plot(&self, shown: (f64, f64)) -> Plot {
        let step = 1.0 / self.groups.len().max(1) as f64;
        let middle_of_group = |index: usize| step * (index as f64 + 0.5);
        let names: Vec<&str> = self.groups.iter().map(|group| group.name.as_str()).collect();
        let names = shorten_distinctly(&names, TEXT, PLOT_WIDTH * step - TEXT_DISTANCE);
        // The empty line above each name is room for the counts, which are separate labels.
        let count_line = if self.has_room_for_counts() { "\u{a0}\n" } else { "" };
        let ticks = names.into_iter().enumerate();
        let ticks = ticks.map(|(index, name)| Tick {
            value: 0.0,
            at: middle_of_group(index),
            text: format!("{count_line}{name}"),
        });
        let x = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(ticks.collect()));
        let mut plot = Plot::new(x, self.unit.axis(self.scale(shown)).with_grid());
        for (index, group) in self.groups.iter().enumerate() {
            // A twentieth (0.05) of the width of a group stays free on each side.
            let placement_width = step * PLACEMENTS_SHARE / group.values.len().max(1) as f64;
            for (placement, values) in group.values.iter().enumerate() {
                let middle = step * (index as f64 + 0.05) + placement_width * (placement as f64 + 0.5);
                // A distribution takes at most 80 % of its width, so that neighbouring
                // distributions do not touch.
                let half_width = (placement_width * 0.4).min(MAX_HALF_WIDTH);
                let items = self.distribution_items(&plot, values, placement, (middle, half_width));
                plot.items.extend(items);
                if !count_line.is_empty() && !values.is_empty() {
                    let at = At::new(middle, 1.0).offset_by(0.0, COUNT_DISTANCE);
                    let label = Label::new(at, count_text(values), TextStyle::AXIS).anchored(Anchor::Middle);
                    // The shift 0 puts the baseline of the label, instead of its middle, at the
                    // place.
                    plot.items.push(Item::Text(label.shifted(0.0, 0.0)));
                }
            }
            if let Some(ratio) = group.ratio() {
                let label = Label::new(At::new(middle_of_group(index), 0.0), ratio, TextStyle::MARK);
                plot.items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, 1.0)));
            }
        }
        plot
    }
}
