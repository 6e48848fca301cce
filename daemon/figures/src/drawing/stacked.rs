//! Figure of stacked stages: one bar for each configuration, with an error bar for the total.

use peernet_analysis::compare::LatencyBar;
use peernet_analysis::stage_split::part_order;
use peernet_logger::Name;
use peernet_statistics::number::mean_std;

use super::stack::Orientation;
use super::stage_bar::{BarPlace, StageBar, StagePart};
use crate::look::{TextStyle, label, stage};
use crate::plot::{Anchor, Axis, Figure, Height, Item, Key, Label, Marks, Plot, Swatch, Unit};
use crate::render::file::{MAX_NAME_WIDTH, SMALL, TEXT, WIDTH};
use crate::scale::{Scale, Tick};
use crate::text::width;

/// Height of a horizontal bar with the space around it, points.
const ROW_HEIGHT: f64 = 14.4;
/// Height of a horizontal bar with the space around it if there are many bars, points. With this height, sixty bars
/// fill a page.
const CLOSE_ROW_HEIGHT: f64 = 10.0;
/// Maximum number of bars with [`ROW_HEIGHT`]. If there are more bars, all bars have [`CLOSE_ROW_HEIGHT`].
const MAX_WIDE_ROWS: usize = 16;
/// Maximum number of upright bars, because their labels must fit side by side.
const MAX_UPRIGHT_BARS: usize = 6;
/// Space at the sides of the bars of an upright plot, points.
const SIDE_MARGIN: f64 = 39.0;
/// Space at the sides of the names of horizontal bars, points.
const NAME_DISTANCE: f64 = 16.0;
/// Space at the sides of the text of the total after a horizontal bar, points.
const TOTAL_DISTANCE: f64 = 4.5;
/// Width of a bar as a share of the distance between two bars.
const BAR_SHARE: f64 = 0.6;
/// Maximum width of a bar as a share of the plot.
const MAX_BAR_SHARE: f64 = 0.19;
/// Height of the room for the text of the total above the tallest bar, as a share of the range of values.
const TOTAL_HEIGHT: f64 = 0.12;
/// Half the width of an error bar's cap, points.
const CAP_HALF_WIDTH: f64 = 1.8;

/// Bars of stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Stacked {
    /// Title of the figure.
    pub title: String,
    /// Unit of the axis of values: ms.
    pub unit: Unit,
    /// Stages in the order of time. Every bar has a value for each stage. The value is 0 for a stage that the
    /// configuration does not have.
    pub stages: Vec<String>,
    /// One bar for each configuration.
    pub bars: Vec<Bar>,
    /// Notes below the figure, such as the meaning of the parts and what is left out.
    pub notes: Vec<String>,
}

/// Bar of a configuration. Values are in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Label of the configuration.
    pub label: String,
    /// Mean of each stage of the figure. A mean may be negative if the clocks are not related.
    pub means: Vec<f64>,
    /// Mean of the total. If the means of all stages are known, they add up to the total.
    pub total: f64,
    /// Standard deviation of the total; `None` if it is not known.
    pub std: Option<f64>,
}

impl Bar {
    /// Returns the mean and the standard deviation of the total; `None` unless the deviation is known and above 0.
    fn mean_and_std(&self) -> Option<(f64, f64)> {
        self.std.filter(|std| *std > 0.0).map(|std| (self.total, std))
    }

    /// Returns the lowest and the highest value that the bar and its error bar reach.
    fn range(&self) -> (f64, f64) {
        // Parts below zero are stacked downwards, so they do not shorten the bar above zero.
        let sum_of =
            |is_included: fn(f64) -> bool| self.means.iter().filter(|mean| is_included(**mean)).sum::<f64>();
        let (negative_sum, positive_sum) = (sum_of(|mean| mean < 0.0), sum_of(|mean| mean > 0.0));
        (negative_sum.min(self.total), positive_sum.max(self.total + self.std.unwrap_or_default()))
    }

    /// Returns the total with its standard deviation in ms: `22.4 ± 2.1`.
    fn total_text(&self) -> String {
        mean_std(self.total, self.std)
    }
}

impl Stacked {
    /// Returns the figure of these bars, each given with its label. The axis is in ms. The stages of the figure are the
    /// parts that at least one bar has.
    pub fn new(title: &str, bars: &[(String, LatencyBar)], notes: Vec<String>) -> Self {
        let has_part = |name: &Name| bars.iter().any(|(_, bar)| bar.part(name).is_some());
        let stages: Vec<Name> = part_order().filter(has_part).collect();
        let bar = |(label, bar): &(String, LatencyBar)| Bar {
            label: label.clone(),
            means: stages.iter().map(|stage| bar.part(stage).unwrap_or_default()).collect(),
            total: bar.total,
            std: bar.std,
        };
        Self {
            title: title.to_owned(),
            unit: Unit::milliseconds("Latency"),
            bars: bars.iter().map(bar).collect(),
            stages: stages.iter().map(Name::to_string).collect(),
            notes,
        }
    }

    /// Lays each bar out as a separate picture with the values of its parts, for pages. Returns the pictures and their
    /// common scale, in ms.
    pub fn rows(&self) -> (Vec<Vec<Item>>, Scale) {
        let (low, high) = self.range();
        let scale = if low < 0.0 { Scale::from_zero((low, high)) } else { Scale::up_to(high, 6) };
        let row = |bar: &Bar| {
            let parts = self.parts(bar);
            StageBar { mean_and_std: bar.mean_and_std(), ..StageBar::new(&parts, scale) }.items()
        };
        (self.bars.iter().map(row).collect(), scale)
    }

    /// Returns the parts of a bar.
    fn parts(&self, bar: &Bar) -> Vec<StagePart> {
        let part = |(name, seconds): (&String, &f64)| StagePart {
            name: name.clone(),
            seconds: *seconds,
            bound: None,
        };
        self.stages.iter().zip(&bar.means).map(part).collect()
    }

    /// Returns whether the bars are upright. The bars are upright if they are few and their labels are short.
    fn is_upright(&self) -> bool {
        let room = (WIDTH - SIDE_MARGIN) / self.bars.len().max(1) as f64 - 3.0;
        let fits = |text: &str, size: f64| width(text, size) <= room;
        self.bars.len() <= MAX_UPRIGHT_BARS
            && self.bars.iter().all(|bar| {
                bar.label.split(", ").all(|line| fits(line, TEXT)) && fits(&bar.total_text(), SMALL)
            })
    }

    /// Returns the lowest and the highest value that the bars reach, in the unit that is shown.
    fn range(&self) -> (f64, f64) {
        let ranges = self.bars.iter().map(Bar::range);
        let (lo, hi) = ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default();
        (lo * self.unit.per_si, hi * self.unit.per_si)
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let key = |name: &String| Key::new(Swatch::Area(stage(name).area()), label(name));
        let plots = if self.bars.is_empty() {
            Vec::new()
        } else if self.is_upright() {
            vec![self.upright_plot()]
        } else {
            vec![self.horizontal_plot()]
        };
        let legend = self.stages.iter().map(key).collect();
        Figure { title: self.title.clone(), legend, notes: self.notes.clone(), plots, ..Figure::default() }
    }

    fn upright_plot(&self) -> Plot {
        let (low, high) = self.range();
        let values = Scale::from_zero((low, high + (high - low) * TOTAL_HEIGHT));
        let count = self.bars.len() as f64;
        let middle = |index: usize| (index as f64 + 0.5) / count;
        let names = self.bars.iter().enumerate().map(|(index, bar)| Tick {
            value: 0.0,
            at: middle(index),
            text: bar.label.replace(", ", "\n"),
        });
        let names = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(names.collect()));
        let mut plot = Plot::new(names, self.unit.axis(values).with_grid());
        let half_width = (BAR_SHARE / count / 2.0).min(MAX_BAR_SHARE / 2.0);
        for (index, bar) in self.bars.iter().enumerate() {
            let (items, end) =
                self.bar_items(bar, values, (middle(index), half_width), Orientation::Vertical);
            plot.items.extend(items);
            let label = Label::new(
                Orientation::Vertical.at(values.at(end), middle(index)),
                bar.total_text(),
                TextStyle::MARK,
            );
            plot.items.push(Item::Text(label.anchored(Anchor::Middle).shifted(0.0, -0.35)));
        }
        plot
    }

    fn horizontal_plot(&self) -> Plot {
        let values = Scale::from_zero(self.range());
        let count = self.bars.len() as f64;
        let middle = |index: usize| (index as f64 + 0.5) / count;
        let names = self.bars.iter().enumerate();
        let names =
            names.map(|(index, bar)| Tick { value: 0.0, at: 1.0 - middle(index), text: bar.label.clone() });
        let names = Axis::new(Scale::linear((0.0, 1.0)), "", "").marked(Marks::Names(names.collect()));
        let mut plot = Plot::new(self.unit.axis(values).with_grid(), names);
        plot.height = Height::Points(
            count * if self.bars.len() > MAX_WIDE_ROWS { CLOSE_ROW_HEIGHT } else { ROW_HEIGHT },
        );
        plot.free_right = self.free_space(values);
        for (index, bar) in self.bars.iter().enumerate() {
            let (items, end) = self.bar_items(
                bar,
                values,
                (middle(index), BAR_SHARE / count / 2.0),
                Orientation::Horizontal,
            );
            plot.items.extend(items);
            let at = Orientation::Horizontal.at(values.at(end), middle(index));
            plot.items.push(Item::Text(Label::new(at, bar.total_text(), TextStyle::MARK).shifted(0.4, 0.36)));
        }
        plot
    }

    /// Returns the width that must stay free at the right of the plot for the totals that follow horizontal bars,
    /// points. The total of a short bar needs less of this width, because its text begins at the end of the bar.
    fn free_space(&self, values: Scale) -> f64 {
        let names_width = self.bars.iter().map(|bar| width(&bar.label, TEXT)).fold(0.0, f64::max);
        let available_width = WIDTH - NAME_DISTANCE - names_width.min(MAX_NAME_WIDTH);
        // Maximum width of the plot at which a bar and the text of its total fit into the available width.
        let max_plot_width = |bar: &Bar| {
            let total_width = width(&bar.total_text(), SMALL) + TOTAL_DISTANCE;
            // The minimum avoids a division by zero for a bar without length.
            (available_width - total_width) / values.at(bar.range().1 * self.unit.per_si).max(0.1)
        };
        available_width - self.bars.iter().map(max_plot_width).fold(available_width, f64::min)
    }

    /// Returns the items of a bar and its error bar, and the highest value that they reach, in the unit that is shown.
    /// `middle` is the centre of the bar and `half_width` is half its width, both as shares of the plot across the
    /// bars.
    fn bar_items(
        &self,
        bar: &Bar,
        values: Scale,
        (middle, half_width): (f64, f64),
        orientation: Orientation,
    ) -> (Vec<Item>, f64) {
        let parts = self.parts(bar);
        let place = BarPlace {
            orientation,
            sides: (middle - half_width, middle + half_width),
            cap_half_width: CAP_HALF_WIDTH,
        };
        let stage_bar = StageBar {
            has_grid: false,
            has_values: false,
            mean_and_std: bar.mean_and_std(),
            place,
            ..StageBar::new(&parts, values)
        };
        (stage_bar.items(), bar.range().1 * self.unit.per_si)
    }
}
