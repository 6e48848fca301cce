//! Axes: a scale with its title and its marks.

use std::borrow::Cow;

use peernet_statistics::number::{decimals, fixed};

use crate::scale::{Scale, Tick};

/// Marks on an axis that has no other number.
pub(super) const MARKS: usize = 6;

/// Quantity: its name and the factor from a value in SI units to the number shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Title with the unit: `One-way delay, ms`.
    pub title: String,
    /// Symbol of the unit, for figures in words; empty for a count.
    pub symbol: Cow<'static, str>,
    /// The number shown per SI unit.
    pub per_si: f64,
}

impl Unit {
    /// Returns the unit of seconds, shown as ms.
    pub fn milliseconds(what: &str) -> Self {
        Self { title: format!("{what}, ms"), symbol: "ms".into(), per_si: 1e3 }
    }

    /// Returns the unit of bits per second, shown as MB/s.
    pub fn megabytes_per_second(what: &str) -> Self {
        Self { title: format!("{what}, MB/s"), symbol: "MB/s".into(), per_si: 1.0 / 8e6 }
    }

    /// Returns a unit without another name than its symbol, for pages.
    pub fn symbol(symbol: &str, per_si: f64) -> Self {
        Self { title: symbol.to_owned(), symbol: symbol.to_owned().into(), per_si }
    }

    /// Returns a value in SI units in words: `5.66 ms`. It has three digits, or as many as distinguish it from values that are `spread`
    /// apart.
    pub fn words(&self, value: f64, spread: f64) -> String {
        let finer = if spread > 0.0 { decimals(spread * self.per_si, 2) } else { 0 };
        let number = fixed(value * self.per_si, decimals(value * self.per_si, 3).max(finer));
        if self.symbol.is_empty() { number } else { format!("{number} {}", self.symbol) }
    }

    /// Returns an axis of this unit.
    pub fn axis(&self, scale: Scale) -> Axis {
        Axis::new(scale, self.title.clone(), self.symbol.clone())
    }
}

/// Places of the marks of an axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Marks {
    /// Marks at round numbers, at most about this many.
    Round(usize),
    /// Marks at these places.
    At(Vec<Tick>),
    /// Marks at categories; their names may have several lines.
    Names(Vec<Tick>),
}

/// Axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Scale, in the unit that is shown.
    pub scale: Scale,
    /// Name of the quantity with the unit; files write it out.
    pub title: String,
    /// Name of the unit; pages show only that, because a panel's title names the quantity.
    pub unit: Cow<'static, str>,
    /// Places of its marks.
    pub marks: Marks,
    /// True if its marks go through the plot.
    pub has_grid: bool,
}

impl Axis {
    /// Returns an axis with round marks and without a grid.
    pub fn new(scale: Scale, title: impl Into<String>, unit: impl Into<Cow<'static, str>>) -> Self {
        let (title, unit) = (title.into(), unit.into());
        Self { scale, title, unit, marks: Marks::Round(MARKS), has_grid: false }
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

    /// Returns the same axis with labels that `label` makes of its round marks.
    #[must_use]
    pub fn labelled(self, label: impl Fn(&Tick) -> String) -> Self {
        let ticks = self.ticks(MARKS).into_iter();
        let ticks = ticks.map(|tick| Tick { text: label(&tick), ..tick }).collect();
        self.marked(Marks::At(ticks))
    }

    /// Returns the marks if there is room for `room` of them.
    pub fn ticks(&self, room: usize) -> Vec<Tick> {
        match &self.marks {
            Marks::Round(most) => self.scale.ticks((*most).min(room.max(1))),
            Marks::At(ticks) | Marks::Names(ticks) => ticks.clone(),
        }
    }

    /// Returns the name of its unit with the information that its marks alone do not show: the title on a page, which may be empty.
    pub fn page_title(&self) -> String {
        let scale = if self.scale.is_logarithmic() { "logarithmic" } else { "" };
        [&*self.unit, scale].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// Returns its title with the information that its marks alone do not show.
    pub fn full_title(&self) -> String {
        if self.scale.is_logarithmic() && !self.title.is_empty() {
            format!("{} (log scale)", self.title)
        } else {
            self.title.clone()
        }
    }
}
