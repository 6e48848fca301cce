//! Legends.

use crate::look::{Mark, Style};

/// Sample of the look that an entry of a legend explains.
#[derive(Clone, Debug, PartialEq)]
pub enum Swatch {
    /// Filled area.
    Area(Style),
    /// Line alone.
    Line(Style),
    /// Mark alone.
    Mark(Mark, Style),
    /// Line or area with a mark: the style of the line or area, the mark, and the style of the mark.
    Curve(Style, Mark, Style),
}

/// Entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Sample of the look.
    pub swatch: Swatch,
    /// Meaning of the look.
    pub text: String,
}

impl Key {
    /// Returns an entry.
    pub fn new(swatch: Swatch, text: impl Into<String>) -> Self {
        Self { swatch, text: text.into() }
    }
}
