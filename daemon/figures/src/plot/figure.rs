//! Figures: plots with their legend, table and notes.

use super::axis::Axis;
use super::item::{At, Item};
use super::legend::Key;

/// Strip at a plot, such as the distribution of a quantity of the plot. Positions are shares of the strip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Strip {
    /// Items of the strip.
    pub items: Vec<Item>,
    /// Height in a file, or the width if the strip is at the side of a plot, points.
    pub size: f64,
}

/// Height of a plot in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Height {
    /// The rest of the figure.
    Rest,
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
    /// Items of the plot, the lowest first.
    pub items: Vec<Item>,
    /// Strip above, which shares the horizontal axis.
    pub above: Option<Strip>,
    /// Strip at the right, which shares the vertical axis.
    pub beside: Option<Strip>,
    /// Text above its right end, such as a count of values beyond its axes.
    pub remark: Option<String>,
    /// Number of lines of text above the plot, such as labels of quantiles.
    pub lines_above: usize,
    /// Height in a file.
    pub height: Height,
    /// Points left free at its right in a file, for text that reaches over its end.
    pub free: f64,
}

impl Plot {
    /// Returns an empty plot.
    pub fn new(x: Axis, y: Axis) -> Self {
        let (items, above, beside, remark) = (Vec::new(), None, None, None);
        Self { x, y, items, above, beside, remark, lines_above: 0, height: Height::Rest, free: 0.0 }
    }

    /// Returns the position of two values, which are in the units of the axes.
    pub fn at(&self, x: f64, y: f64) -> At {
        At::new(self.x.scale.at(x), self.up(y))
    }

    /// Returns the distance of a value of the vertical axis from the top, as a share.
    pub fn up(&self, y: f64) -> f64 {
        1.0 - self.y.scale.at(y)
    }
}

/// Lines of columns below the plots: a key to numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Titles of the columns behind the names.
    pub titles: Vec<String>,
    /// Name and cells of each line.
    pub lines: Vec<(String, Vec<String>)>,
}

/// Figure of one or more plots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Title.
    pub title: String,
    /// Entries for all that differs by colour, mark or dash.
    pub legend: Vec<Key>,
    /// Sentences for the figure's text file: how to read it, numbers of values, what is left out.
    pub notes: Vec<String>,
    /// Plots from top to bottom. Without one the figure says that there are no values.
    pub plots: Vec<Plot>,
    /// Key to numbers in the plots.
    pub table: Table,
}

impl Figure {
    /// Returns the line above the figure: the title and the number of values.
    pub fn caption(&self) -> String {
        let parts = self.notes.iter().flat_map(|note| note.split(" · "));
        match parts.into_iter().find(|part| part.starts_with("n = ")) {
            Some(n) => format!("{} · {n}", self.title),
            None => self.title.clone(),
        }
    }

    /// Returns the text for the figure's text file: title, axes, legend, notes, each in a line.
    pub fn words(&self) -> String {
        let mut lines = vec![self.title.clone()];
        for plot in &self.plots {
            let axes = [plot.y.full_title(), plot.x.full_title()];
            let named: Vec<String> = axes.into_iter().filter(|title| !title.is_empty()).collect();
            lines.push(named.join(" against "));
            lines.extend(plot.remark.clone());
        }
        lines.extend(self.legend.iter().map(|key| format!("Legend: {}", key.text)));
        lines.extend(self.notes.iter().cloned());
        lines.retain(|line| !line.is_empty());
        lines.join("\n") + "\n"
    }
}
