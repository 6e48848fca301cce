//! Figure of one quantity at several placements: the same model on the robot and in the cloud, side by side.

mod density;

use peernet_statistics::number::{counted, fixed, significant};

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
/// Largest value of half the width of a shape, as a share of the plot's width.
const MAX_HALF_WIDTH: f64 = 0.09;
/// Margin above the largest value, as a share of the range.
const MARGIN_ABOVE: f64 = 0.12;
/// Distance from the plot to the baseline of the counts, points.
const COUNT_DISTANCE: f64 = 9.5;
/// Maximum number of values that are drawn as points. More values are drawn as a shape.
const MAX_POINTS: usize = 60;
/// Points beyond the shown range are drawn, too, up to this multiple of the end of the range: there is room for them
/// below the text at the top.
const ROOM_FOR_POINTS: f64 = 1.05;
/// The axis is logarithmic if the ratio of the largest to the smallest median is at least this.
const LOGARITHMIC_RATIO: f64 = 30.0;
/// Maximum number of placements whose distributions a reader can distinguish.
pub const MAX_PLACEMENTS: usize = 4;
/// Maximum number of groups that fit into the width of a column.
pub const MAX_GROUPS: usize = 12;

/// Distributions side by side, in groups.
#[derive(Clone, Debug, PartialEq)]
pub struct Paired {
    /// Title of the figure.
    pub title: String,
    /// Unit of the vertical axis.
    pub unit: Unit,
    /// Names of the placements, in the order of the distributions in each group: at most four.
    pub placements: Vec<String>,
    /// One group for each model: at most twelve.
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
    /// Returns the ratio of the median at the first placement to the median at the second, such as `2.5 ×`; `None` unless there are two placements.
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
            let counts = || self.groups.iter().flat_map(|group| &group.values).map(SortedValues::len);
            let ends = counts().filter(|count| *count > 0).min().zip(counts().max());
            notes.extend(ends.map(|(min, max)| {
                let [min, max] = [min, max].map(|count| fixed(count as f64, 0));
                if min == max { format!("n = {max} each") } else { format!("n = {min} to {max} each") }
            }));
        }
        let has_points = |values: &SortedValues| !values.is_empty() && self.is_drawn_as_points(values);
        if self.groups.iter().flat_map(|group| &group.values).any(has_points) {
            notes.push(format!(
                "up to {MAX_POINTS} values: a point each, spread sideways so that none hides another; the black mark among them is the median"
            ));
        }
        if self.groups.iter().any(|group| group.ratio().is_some()) {
            notes.push(format!("above a pair: median {} ÷ {}", self.placements[0], self.placements[1]));
        }
        if self.groups.iter().flat_map(|group| &group.values).any(|values| self.count_above(values) > 0) {
            notes.push("+ and a number: number of values above the axis".to_owned());
        }
        let below = self
            .groups
            .iter()
            .flat_map(|group| &group.values)
            .map(|values| self.count_below(values))
            .sum::<usize>();
        if below > 0 {
            notes.push(format!("smaller than shown: {}", counted(below as u64, "value")));
        }
        notes
    }

    /// Returns whether there is room for the count below each distribution.
    fn has_room_for_counts(&self) -> bool {
        let sides = self.groups.iter().map(|group| group.values.len()).max().unwrap_or(1);
        let max_width = PLOT_WIDTH * 0.9 / (self.groups.len() * sides).max(1) as f64 - 1.8;
        let mut distributions = self.groups.iter().flat_map(|group| &group.values);
        distributions.all(|values| width(&count_text(values), SMALL) <= max_width)
    }

    /// Returns the range of values that the axis must show: every distribution, without tails that would leave little
    /// space for the rest. `None` without finite values.
    fn shown_range(&self) -> Option<(f64, f64)> {
        let ends = |values: &SortedValues| {
            let (lo, hi) = shown_range_of(values)?;
            // If values are drawn as points, all points above zero are shown, even if one is far below the others.
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

    /// Returns the largest of these values that is drawn. If they are drawn as points, it is the largest value that
    /// fits on the axis. If they are drawn as a shape, it is the largest value that is not in the tail.
    fn highest_shown(&self, values: &SortedValues) -> Option<f64> {
        let (_, hi) = shown_range_of(values)?;
        if values.len() > MAX_POINTS {
            return Some(hi);
        }
        let (_, end) = self.shown_range()?;
        values.values().iter().rev().copied().find(|value| *value <= end * ROOM_FOR_POINTS)
    }

    /// Returns the number of values above the shown range.
    fn count_above(&self, values: &SortedValues) -> usize {
        let count = |highest| values.values().iter().filter(|value| **value > highest).count();
        self.highest_shown(values).map_or(0, count)
    }

    /// Returns the number of values below the shown range.
    fn count_below(&self, values: &SortedValues) -> usize {
        let lowest = if values.len() > MAX_POINTS { shown_range_of(values) } else { self.shown_range() };
        let count = |(lowest, _)| values.values().iter().filter(|value| **value < lowest).count();
        lowest.map_or(0, count)
    }

    /// Returns the outline of a distribution: values, each with its density from 0 to 1. Empty if the values have no
    /// spread.
    fn shape(&self, values: &SortedValues) -> Vec<(f64, f64)> {
        let Some(ends) = shown_range_of(values) else { return Vec::new() };
        if self.is_logarithmic() { log_density(values, ends) } else { density(values, ends) }
    }

    /// Returns whether the values are drawn as points and not as a shape.
    fn is_drawn_as_points(&self, values: &SortedValues) -> bool {
        values.len() <= MAX_POINTS || self.shape(values).len() <= 1
    }

    /// Returns the items of one distribution. `side` is the index of its placement, `middle` is its position, and
    /// `half` is half of its maximum width. Position and width are shares of the plot's width.
    fn distribution_items(
        &self,
        plot: &Plot,
        values: &SortedValues,
        side: usize,
        (middle, half): (f64, f64),
    ) -> Vec<Item> {
        let look = series(side);
        let y = |value: f64| plot.y_share(value * self.unit.per_si);
        let Some((lo, _)) = shown_range_of(values) else { return Vec::new() };
        let highest = self.highest_shown(values);
        let mut items = Vec::new();
        if !self.is_drawn_as_points(values) {
            let shape = self.shape(values);
            let edge = |sign: f64| {
                shape.iter().map(move |(value, density)| (middle + sign * half * density, y(*value)))
            };
            let outline: Vec<(f64, f64)> =
                edge(1.0).chain(edge(-1.0).collect::<Vec<_>>().into_iter().rev()).collect();
            items.push(Item::path(Path::polygon(outline), look.shape()));
        } else {
            let lowest = self.shown_range().map_or(lo, |(lowest, _)| lowest);
            let is_shown =
                |value: &&f64| **value >= lowest && highest.is_some_and(|highest| **value <= highest);
            for (number, value) in values.values().iter().filter(is_shown).enumerate() {
                // Points are spread to the sides by the golden ratio, so that each is visible and the figure is reproducible.
                let offset = (number as f64 * 0.618_034).fract() - 0.5;
                let at = At::new(middle + offset * half, y(*value));
                items.push(Item::mark(at, look.mark, RADIUS, look.shape()));
            }
        }
        if values.len() >= 4
            && let Some((low, high)) = values.quantile(0.25).zip(values.quantile(0.75))
        {
            let bar = |grow: f64, style: Style| {
                let (from, to) = (At::new(middle, y(high)), At::new(middle, y(low)));
                Item::rect(
                    from.offset_by(-BAR_HALF_WIDTH - grow, -grow),
                    to.offset_by(BAR_HALF_WIDTH + grow, grow),
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
        if let Some(highest) = highest.filter(|_| above > 0) {
            // The label must not touch the highest point.
            let at = At::new(middle, y(highest)).offset_by(0.0, -3.0);
            let label = Label::new(at, format!("+{}", fixed(above as f64, 0)), TextStyle::BEYOND);
            items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, 0.0)));
        }
        items
    }
}

/// Returns the density of the logarithms, which is the width of the shape on a logarithmic axis.
fn log_density(values: &SortedValues, (lo, hi): (f64, f64)) -> Vec<(f64, f64)> {
    let logarithms: SortedValues =
        values.values().iter().filter(|value| **value > 0.0).map(|value| value.ln()).collect();
    density(&logarithms, (lo.ln(), hi.ln())).into_iter().map(|(at, dense)| (at.exp(), dense)).collect()
}

/// Returns the text of a count, such as `n = 1,200`.
fn count_text(values: &SortedValues) -> String {
    format!("n = {}", fixed(values.len() as f64, 0))
}

impl Paired {
    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let key = |(number, name): (usize, &String)| {
            let look = series(number);
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
            // On a logarithmic axis the margin for the ratios at the top is a factor.
            let margin = (hi / lo).powf(MARGIN_ABOVE);
            Scale::logarithmic((lo / margin.sqrt(), hi * margin))
        } else {
            Scale::from_zero((lo, hi * (1.0 + MARGIN_ABOVE)))
        }
    }

    fn plot(&self, shown: (f64, f64)) -> Plot {
        let step = 1.0 / self.groups.len().max(1) as f64;
        let middle_of_group = |number: usize| step * (number as f64 + 0.5);
        let names: Vec<&str> = self.groups.iter().map(|group| group.name.as_str()).collect();
        let names = shorten_distinctly(&names, TEXT, PLOT_WIDTH * step - 1.8);
        let counts = if self.has_room_for_counts() { "\u{a0}\n" } else { "" };
        let ticks = names.into_iter().enumerate();
        let ticks = ticks.map(|(number, name)| Tick {
            value: 0.0,
            at: middle_of_group(number),
            text: format!("{counts}{name}"),
        });
        let x = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(ticks.collect()));
        let mut plot = Plot::new(x, self.unit.axis(self.scale(shown)).with_grid());
        for (number, group) in self.groups.iter().enumerate() {
            let placement_width = step * 0.9 / group.values.len().max(1) as f64;
            for (side, values) in group.values.iter().enumerate() {
                let middle = step * (number as f64 + 0.05) + placement_width * (side as f64 + 0.5);
                let items = self.distribution_items(
                    &plot,
                    values,
                    side,
                    (middle, (placement_width * 0.4).min(MAX_HALF_WIDTH)),
                );
                plot.items.extend(items);
                if !counts.is_empty() && !values.is_empty() {
                    let at = At::new(middle, 1.0).offset_by(0.0, COUNT_DISTANCE);
                    let label = Label::new(at, count_text(values), TextStyle::AXIS).anchored(Anchor::Middle);
                    plot.items.push(Item::Text(label.shifted(0.0, 0.0)));
                }
            }
            if let Some(ratio) = group.ratio() {
                let label = Label::new(At::new(middle_of_group(number), 0.0), ratio, TextStyle::MARK);
                plot.items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, 1.0)));
            }
        }
        plot
    }
}
