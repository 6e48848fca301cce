//! Text: its width in the embedded font Inter, and how it is shortened to fit.

mod fit;
mod font;
mod panel;

pub use fit::{shorten, shorten_distinctly, wrap};
pub use font::{FAMILY, FONT, missing_glyph, width};
pub use panel::{WIDTH_STEPS, width_rem, width_step};
