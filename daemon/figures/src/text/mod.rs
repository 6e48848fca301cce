//! Text: how wide it is in the embedded Inter, and making it fit.

mod fit;
mod font;
mod panel;

pub use fit::{shorten, shorten_apart, wrap};
pub use font::{FAMILY, FONT, missing_glyph, width};
pub use panel::{WIDTH_STEPS, rem, width_step};
