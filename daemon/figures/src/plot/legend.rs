//! Legends.

use crate::look::{Mark, Style};

/// Sample of what an entry of a legend explains.
#[derive(Clone, Debug, PartialEq)]
pub enum Swatch {
    /// A filled area.
    Area(Style),
    /// A line.
    Line(Style),
    /// A mark.
    Mark(Mark, Style),
    /// A line with a mark on it: the styles of both.
    Curve(Style, Mark, Style),
}

/// Entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Its sample.
    pub swatch: Swatch,
    /// Its meaning.
    pub text: String,
}

impl Key {
    /// An entry.
    pub fn new(swatch: Swatch, text: impl Into<String>) -> Self {
        Self { swatch, text: text.into() }
    }
}
