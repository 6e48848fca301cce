//! Figures: plots with their legend, table and notes.

use super::axis::Axis;
use super::item::{At, Item};
use super::legend::Key;
use super::path::Path;

/// Number of straight pieces of the graph of a function. Even a straight line needs several pieces, because it is a
/// curve on logarithmic axes.
const CURVE_PIECES: u32 = 64;
/// Number of bisections that find the place at which a curve leaves the plot. The error of this place is a millionth of
/// the length of a piece.
const BISECTIONS: u32 = 20;

/// Strip along one side of a plot, such as the distribution of one of the plot's quantities. The positions of its items
/// are shares of the strip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Strip {
    /// Items of the strip.
    pub items: Vec<Item>,
    /// Height of a strip above the plot, or width of a strip at the right of the plot, in a file, points.
    pub size: f64,
}

/// Height of a plot in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Height {
    /// Share of the height that the header, the titles, the labels and the plots with a fixed height leave. All
    /// flexible plots of a figure are equally high.
    Flexible,
    /// Height in points.
    Points(f64),
}

/// Plot with its axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Items of the plot. Each item is drawn over the items before it.
    pub items: Vec<Item>,
    /// Strip above the plot. It shares the horizontal axis.
    pub top_strip: Option<Strip>,
    /// Strip at the right of the plot. It shares the vertical axis.
    pub right_strip: Option<Strip>,
    /// Text above the right end of the plot, such as a count of values beyond the axes.
    pub remark: Option<String>,
    /// Number of lines of text above the plot, such as labels of quantiles.
    pub lines_above: usize,
    /// Height in a file.
    pub height: Height,
    /// Width that stays free at the right of the plot in a file, for text that extends beyond the plot; points.
    pub free_right: f64,
}

impl Plot {
    /// Returns the graph of a function as a path. The function maps values of the horizontal axis, between `from` and
    /// `to`, to values of the vertical axis. The path is interrupted where it leaves the plot.
    pub fn curve(&self, (from, to): (f64, f64), function: impl Fn(f64) -> f64) -> Path {
        let is_inside = |x: f64| self.y.scale.has(function(x));
        // Returns the value between `inside` and `outside` at which the function leaves the plot.
        let boundary = |mut inside: f64, mut outside: f64| {
            for _ in 0..BISECTIONS {
                let middle = self.x.scale.between(inside, outside, 0.5);
                *(if is_inside(middle) { &mut inside } else { &mut outside }) = middle;
            }
            inside
        };
        let mut xs: Vec<Option<f64>> = Vec::new();
        let mut previous: Option<f64> = None;
        for piece in 0..=CURVE_PIECES {
            let x = self.x.scale.between(from, to, f64::from(piece) / f64::from(CURVE_PIECES));
            match (previous, is_inside(x)) {
                (Some(before), true) if !is_inside(before) => xs.extend([Some(boundary(x, before)), Some(x)]),
                (Some(before), false) if is_inside(before) => xs.extend([Some(boundary(before, x)), None]),
                (_, true) => xs.push(Some(x)),
                (_, false) => {}
            }
            previous = Some(x);
        }
        Path::line(xs.into_iter().map(|x| x.map(|x| (self.x.scale.at(x), self.y_share(function(x))))))
    }

    /// Returns an empty plot.
    pub fn new(x: Axis, y: Axis) -> Self {
        Self {
            x,
            y,
            items: Vec::new(),
            top_strip: None,
            right_strip: None,
            remark: None,
            lines_above: 0,
            height: Height::Flexible,
            free_right: 0.0,
        }
    }

    /// Returns the position of a point. Its two values are in the units of the axes.
    pub fn at(&self, x: f64, y: f64) -> At {
        At::new(self.x.scale.at(x), self.y_share(y))
    }

    /// Returns the distance from the top of the plot to a value of the vertical axis, as a share of the height.
    pub fn y_share(&self, y: f64) -> f64 {
        1.0 - self.y.scale.at(y)
    }
}

/// Table below the plots, with numbered lines. The plots show the numbers beside their points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Titles of the columns of cells. The column of names has no title.
    pub titles: Vec<String>,
    /// Lines of the table. Each line has a name and cells.
    pub lines: Vec<(String, Vec<String>)>,
}

/// Figure of one or more plots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Title.
    pub title: String,
    /// Entries that explain the colours, marks and dashes.
    pub legend: Vec<Key>,
    /// Sentences for the caption's file: how to read the figure, the number of values, what is left out.
    pub notes: Vec<String>,
    /// Plots from top to bottom. A figure without a plot says that there are no values.
    pub plots: Vec<Plot>,
    /// Table that explains the numbers beside the points.
    pub table: Table,
}

impl Figure {
    /// Returns the line above the figure: the title, followed by the number of values if a note contains this number.
    pub fn caption(&self) -> String {
        // A note may consist of several remarks, such as `n = 120 · left out: 5 warm-up`.
        let mut remarks = self.notes.iter().flat_map(|note| note.split(" · "));
        match remarks.find(|remark| remark.starts_with("n = ")) {
            Some(n) => format!("{} · {n}", self.title),
            None => self.title.clone(),
        }
    }

    /// Returns the text of the caption's file: title, axes, legend and notes, each in a line.
    pub fn caption_text(&self) -> String {
        let mut lines = vec![self.title.clone()];
        for plot in &self.plots {
            let axes = [plot.y.full_title(), plot.x.full_title()];
            let titles: Vec<String> = axes.into_iter().filter(|title| !title.is_empty()).collect();
            lines.push(titles.join(" against "));
            lines.extend(plot.remark.clone());
        }
        lines.extend(self.legend.iter().map(|key| format!("Legend: {}", key.text)));
        lines.extend(self.notes.iter().cloned());
        lines.retain(|line| !line.is_empty());
        lines.join("\n") + "\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scale::Scale;

    #[test]
    fn curve_ends_where_it_leaves_plot() {
        let axis = |ends| Axis::new(Scale::linear(ends), "", "");
        let plot = Plot::new(axis((0.0, 10.0)), axis((1.0, 5.0)));
        let path = plot.curve((0.0, 10.0), |x| x);
        let points: Vec<(f64, f64)> = path.points().collect();
        let is_near = |point: Option<&(f64, f64)>, x: f64, y: f64| {
            point.is_some_and(|point| (point.0 - x).abs() < 1e-6 && (point.1 - y).abs() < 1e-6)
        };
        assert!(is_near(points.first(), 0.1, 1.0) && is_near(points.last(), 0.5, 0.0), "{points:?}");
        assert!(plot.curve((0.0, 10.0), |_| 9.0).is_empty());
    }
}
