//! Figures: one drawing, as SVG and as PNG, legible at the width of one column.
//!
//! No system font is needed: the PNG's text is drawn with the font in `assets/`, and the SVG's stays text.

mod axis;
mod canvas;
mod colour;
mod scaling;

pub use canvas::{Drawn, Figure, FigureError};
pub use colour::{DOWNLOAD, UPLOAD};
pub use scaling::{Mark, Scaling, Series, Unit, Value};
