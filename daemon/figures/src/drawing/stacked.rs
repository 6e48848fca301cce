//! Sums of the stages of several configurations: a bar for each, with the spread of its sum.

use peernet_statistics::number::fixed;

use super::stack::{Direction, Stack};
use crate::look::{TextStyle, stage};
use crate::plot::{Anchor, Axis, Figure, Height, Item, Key, Label, Marks, Plot, Swatch, Unit};
use crate::scale::{Scale, Tick};
use crate::sheet::file::{MOST_NAME, SMALL, TEXT, WIDTH};
use crate::text::width;

/// Height of a lying bar with its room, points.
const ROW: f64 = 14.4;
/// Height of a bar's place if there are many bars, points: sixty fill a page.
const CLOSE: f64 = 10.0;
/// Number of bars from which on they are closer to each other.
const MANY: usize = 16;
/// Maximum number of upright bars: their labels are below them.
const MOST_UPRIGHT: usize = 6;
/// Space at the sides of the bars of an upright plot, points.
const MARGIN: f64 = 39.0;
/// Space between horizontal bars and their names, and between a bar and its sum, points.
const BESIDE: f64 = 16.0;
const AFTER: f64 = 4.5;
/// Share of a bar's place that the bar fills, and its maximum share of the plot.
const THICK: f64 = 0.6;
const WIDEST: f64 = 0.19;
/// Share of the plot's height for the words above the tallest bar.
const WORDS: f64 = 0.12;
/// Half the width of an error bar's cap, points.
const CAP: f64 = 1.8;

/// Bars of stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Stacked {
    /// Title of the figure.
    pub title: String,
    /// Unit of the axis of values.
    pub unit: Unit,
    /// Stages from the first to the last; every bar has a value for each, 0 for a stage that it does not have.
    pub stages: Vec<String>,
    /// One bar for each configuration.
    pub bars: Vec<Bar>,
    /// Notes on how to read the parts.
    pub notes: Vec<String>,
}

/// Bar of a configuration, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Label of the configuration.
    pub label: String,
    /// Mean of each stage. It may be negative if clocks were not corrected.
    pub means: Vec<f64>,
    /// Mean of the total, which the parts add up to as far as all of them are known.
    pub total: f64,
    /// Standard deviation of the total; `None` if it is not known.
    pub std: Option<f64>,
}

impl Bar {
    /// Returns the two ends of the bar, including its error bar.
    fn range(&self) -> (f64, f64) {
        let part = |of: fn(f64) -> bool| self.means.iter().filter(|mean| of(**mean)).sum::<f64>();
        let (below, above) = (part(|mean| mean < 0.0), part(|mean| mean > 0.0));
        (below.min(self.total), above.max(self.total + self.std.unwrap_or_default()))
    }

    /// Returns the sum with its deviation: `22.4 ± 2.1`.
    fn words(&self, unit: &Unit) -> String {
        let decimals = peernet_statistics::number::decimals(self.total * unit.per_si, 3).min(3);
        let total = fixed(self.total * unit.per_si, decimals);
        match self.std {
            Some(std) => format!("{total} ± {}", fixed(std * unit.per_si, decimals)),
            None => total,
        }
    }
}

impl Stacked {
    /// Returns whether the bars are upright: a few bars with short labels.
    fn is_upright(&self) -> bool {
        let room = (WIDTH - MARGIN) / self.bars.len().max(1) as f64 - 3.0;
        let fits = |words: &str, size: f64| width(words, size) <= room;
        self.bars.len() <= MOST_UPRIGHT
            && self.bars.iter().all(|bar| {
                bar.label.split(", ").all(|line| fits(line, TEXT)) && fits(&bar.words(&self.unit), SMALL)
            })
    }

    fn range(&self) -> (f64, f64) {
        let ranges = self.bars.iter().map(Bar::range);
        let (lo, hi) = ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default();
        (lo * self.unit.per_si, hi * self.unit.per_si)
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let key = |name: &String| Key::new(Swatch::Area(stage(name).area()), name.clone());
        let plots = match self.is_upright() {
            _ if self.bars.is_empty() => Vec::new(),
            true => vec![self.upright()],
            false => vec![self.lying()],
        };
        let legend = self.stages.iter().map(key).collect();
        Figure { title: self.title.clone(), legend, notes: self.notes.clone(), plots, ..Figure::default() }
    }

    fn upright(&self) -> Plot {
        let (low, high) = self.range();
        let values = Scale::from_zero((low, high + (high - low) * WORDS));
        let count = self.bars.len() as f64;
        let place = |number: usize| (number as f64 + 0.5) / count;
        let names = self.bars.iter().enumerate().map(|(number, bar)| Tick {
            value: 0.0,
            at: place(number),
            text: bar.label.replace(", ", "\n"),
        });
        let names = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(names.collect()));
        let mut plot = Plot::new(names, self.unit.axis(values).with_grid());
        let half = (THICK / count / 2.0).min(WIDEST / 2.0);
        for (number, bar) in self.bars.iter().enumerate() {
            let (items, end) = self.bar(bar, values, (place(number), half), Direction::Upright);
            plot.items.extend(items);
            let label = Label::new(
                Direction::Upright.at(values.at(end), place(number)),
                bar.words(&self.unit),
                TextStyle::MARK,
            );
            plot.items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, -0.35)));
        }
        plot
    }

    fn lying(&self) -> Plot {
        let values = Scale::from_zero(self.range());
        let count = self.bars.len() as f64;
        let place = |number: usize| (number as f64 + 0.5) / count;
        let names = self.bars.iter().enumerate();
        let names =
            names.map(|(number, bar)| Tick { value: 0.0, at: 1.0 - place(number), text: bar.label.clone() });
        let names = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(names.collect()));
        let mut plot = Plot::new(self.unit.axis(values).with_grid(), names);
        plot.height = Height::Points(count * if self.bars.len() > MANY { CLOSE } else { ROW });
        plot.free = self.free(values);
        for (number, bar) in self.bars.iter().enumerate() {
            let (items, end) = self.bar(bar, values, (place(number), THICK / count / 2.0), Direction::Level);
            plot.items.extend(items);
            let at = Direction::Level.at(values.at(end), place(number));
            plot.items
                .push(Item::Text(Label::new(at, bar.words(&self.unit), TextStyle::MARK).shifted(0.4, 0.36)));
        }
        plot
    }

    /// Returns the space at the right of horizontal bars that their sums need, points. Sums of shorter bars use the space that these leave.
    fn free(&self, values: Scale) -> f64 {
        let names = self.bars.iter().map(|bar| width(&bar.label, TEXT)).fold(0.0, f64::max);
        let across = WIDTH - BESIDE - names.min(MOST_NAME);
        let plot = |bar: &Bar| {
            let sum = width(&bar.words(&self.unit), SMALL) + AFTER;
            (across - sum) / values.at(bar.range().1 * self.unit.per_si).max(0.1)
        };
        across - self.bars.iter().map(plot).fold(across, f64::min)
    }

    /// Returns a bar with its error bar, centred at a place; and its end, in the unit shown.
    fn bar(
        &self,
        bar: &Bar,
        values: Scale,
        (middle, half): (f64, f64),
        direction: Direction,
    ) -> (Vec<Item>, f64) {
        let shown = |value: f64| value * self.unit.per_si;
        let parts = self.stages.iter().map(String::as_str).zip(bar.means.iter().map(|mean| shown(*mean)));
        let stack = Stack { parts: parts.collect(), scale: values };
        let mut items = stack.items((middle - half, middle + half), direction);
        let mut end = shown(bar.total).max(stack.end());
        if let Some(std) = bar.std.map(shown).filter(|std| *std > 0.0) {
            let total = shown(bar.total);
            end = end.max(total + std);
            let ends = [total - std, total + std].map(|value| direction.at(values.at(value), middle));
            let caps = [total - std, total + std].map(|value| values.has(value));
            items.extend(direction.rimmed_whisker(ends, caps, CAP));
        }
        (items, end)
    }
}
