//! Axes. An axis is a scale with a title and marks.

use std::borrow::Cow;

use peernet_statistics::number::{BITS_PER_MB, decimals, fixed};

use crate::scale::{Scale, Tick};

/// Approximate maximum number of marks at round numbers on an axis, unless the axis sets another maximum.
pub(super) const MAX_MARKS: usize = 6;

/// Unit in which a quantity is shown, with the name of the quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Title with the unit: `One-way delay, ms`.
    pub title: String,
    /// Symbol of the unit, for numbers in text; empty for a number without a unit.
    pub symbol: Cow<'static, str>,
    /// Factor from a value in SI units to the number shown: 1,000 for seconds that are shown as ms.
    pub per_si: f64,
}

impl Unit {
    /// Returns the unit of a quantity in seconds that is shown in ms.
    pub fn milliseconds(quantity: &str) -> Self {
        Self { title: format!("{quantity}, ms"), symbol: "ms".into(), per_si: 1e3 }
    }

    /// Returns the unit of a quantity in bits per second that is shown in MB/s.
    pub fn megabytes_per_second(quantity: &str) -> Self {
        Self { title: format!("{quantity}, MB/s"), symbol: "MB/s".into(), per_si: 1.0 / BITS_PER_MB }
    }

    /// Returns a unit whose title is its symbol, for pages.
    pub fn symbol(symbol: &str, per_si: f64) -> Self {
        Self { title: symbol.to_owned(), symbol: symbol.to_owned().into(), per_si }
    }

    /// Returns a value in SI units as text: `5.66 ms`. The number has three significant digits. It has more decimals if
    /// they are needed to show a difference of `spread` with two significant digits; a `spread` of 0 needs no more
    /// decimals. Numbers of bytes have no decimals.
    pub fn format_value(&self, value: f64, spread: f64) -> String {
        let spread_decimals = if spread > 0.0 { decimals(spread * self.per_si, 2) } else { 0 };
        let decimals = decimals(value * self.per_si, 3).max(spread_decimals);
        let number = fixed(value * self.per_si, if self.symbol == "B" { 0 } else { decimals });
        if self.symbol.is_empty() { number } else { format!("{number} {}", self.symbol) }
    }

    /// Returns an axis of this unit.
    pub fn axis(&self, scale: Scale) -> Axis {
        Axis::new(scale, self.title.clone(), self.symbol.clone())
    }
}

/// Positions of the marks of an axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Marks {
    /// Marks at round numbers. The value is the approximate maximum number of marks.
    Round(usize),
    /// Marks at these positions.
    At(Vec<Tick>),
    /// Marks at categories, whose names may have several lines.
    Names(Vec<Tick>),
}

/// Axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Scale, in the unit that is shown.
    pub scale: Scale,
    /// Name of the quantity with the unit. Files show this title.
    pub title: String,
    /// Name of the unit. Pages show only the unit, because the title of the panel names the quantity.
    pub unit: Cow<'static, str>,
    /// Positions of the marks.
    pub marks: Marks,
    /// True if each mark is a line through the plot.
    pub has_grid: bool,
}

impl Axis {
    /// Returns an axis with round marks and without a grid.
    pub fn new(scale: Scale, title: impl Into<String>, unit: impl Into<Cow<'static, str>>) -> Self {
        let (title, unit) = (title.into(), unit.into());
        Self { scale, title, unit, marks: Marks::Round(MAX_MARKS), has_grid: false }
    }

    /// Returns the same axis with a grid.
    #[must_use]
    pub fn with_grid(self) -> Self {
        Self { has_grid: true, ..self }
    }

    /// Returns the same axis with other marks.
    #[must_use]
    pub fn marked(self, marks: Marks) -> Self {
        Self { marks, ..self }
    }

    /// Returns the same axis with its marks at round numbers. `label` returns the text of each mark.
    #[must_use]
    pub fn labelled(self, label: impl Fn(&Tick) -> String) -> Self {
        let ticks = self.ticks(MAX_MARKS).into_iter();
        let labelled_ticks = ticks.map(|tick| Tick { text: label(&tick), ..tick }).collect();
        self.marked(Marks::At(labelled_ticks))
    }

    /// Returns the marks. `max_round_marks` limits the number of marks at round numbers. It does not limit the number
    /// of marks at given positions.
    pub fn ticks(&self, max_round_marks: usize) -> Vec<Tick> {
        match &self.marks {
            Marks::Round(max_marks) => self.scale.ticks((*max_marks).min(max_round_marks.max(1))),
            Marks::At(ticks) | Marks::Names(ticks) => ticks.clone(),
        }
    }

    /// Returns the title on a page: the unit, followed by `logarithmic` for a logarithmic axis. The title of a linear
    /// axis without a unit is empty.
    pub fn page_title(&self) -> String {
        let scale = if self.scale.is_logarithmic() { "logarithmic" } else { "" };
        [&*self.unit, scale].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// Returns the title in a file, followed by `(log scale)` if the scale is logarithmic. The result is empty for an
    /// axis without a title.
    pub fn full_title(&self) -> String {
        if self.scale.is_logarithmic() && !self.title.is_empty() {
            format!("{} (log scale)", self.title)
        } else {
            self.title.clone()
        }
    }
}
