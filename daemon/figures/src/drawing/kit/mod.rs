//! What all figures are drawn with: paper, axes, keys, marks, hatches.

mod axis;
mod canvas;
mod colour;
mod fill;
mod frame;
mod header;
mod mark;
mod text;

pub use canvas::{Drawn, Figure, FigureError, Paper};
pub use colour::{DOWNLOAD, INK, UPLOAD};
pub use fill::{Fill, Hatch};
pub use mark::Mark;

pub(super) use axis::{Axis, Tick};
pub(super) use canvas::{SIZE, SMALL, TEXT, style};
pub(super) use colour::{AXIS, GRID, QUIET, SERIES, SHADE};
pub(super) use fill::fill;
pub(super) use frame::Frame;
pub(super) use header::{Header, Key, Swatch};
pub(super) use text::{shorten_apart, text, text_on_ground, width};

use std::borrow::Cow;

use peernet_statistics::number::{decimals, fixed};

/// What is measured: how it is called and how a value in SI units becomes the number shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// With the unit: `One-way delay, ms`.
    pub title: String,
    /// The unit alone, for figures in words; empty for a count.
    pub symbol: Cow<'static, str>,
    /// The number shown per SI unit.
    pub per_si: f64,
}

impl Unit {
    /// Seconds, shown as ms.
    pub fn milliseconds(what: &str) -> Self {
        Self { title: format!("{what}, ms"), symbol: "ms".into(), per_si: 1e3 }
    }

    /// Bits per second, shown as MB/s.
    pub fn megabytes_per_second(what: &str) -> Self {
        Self { title: format!("{what}, MB/s"), symbol: "MB/s".into(), per_si: 1.0 / 8e6 }
    }

    /// A value in SI units, in words: `5.66 ms`. With three digits, or as many as tell it from others that are
    /// `spread` apart.
    pub(super) fn words(&self, value: f64, spread: f64) -> String {
        let finer = if spread > 0.0 { decimals(spread * self.per_si, 2) } else { 0 };
        let number = fixed(value * self.per_si, decimals(value * self.per_si, 3).max(finer));
        if self.symbol.is_empty() { number } else { format!("{number} {}", self.symbol) }
    }
}
