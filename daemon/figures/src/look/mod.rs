//! Looks of figures: colours, hatches, marks, strokes.
//!
//! A colour always means a stage, a direction, a verdict or a failure. Runs, placements (local or a cloud) and
//! configurations differ by black and greys, marks and dashes ([`series`]). A [`Style`] says how a shape looks: on a
//! page, by a class of the dashboard's style sheet; in a file, by fill and stroke. To add a look, add a function or
//! constant to `style.rs` and a rule to `web/assets/css`. A look that only pages have ([`Style::of_page`]) needs no
//! more than the rule.

mod colour;
mod hatch;
mod mark;
mod stage;
mod style;

pub use colour::{
    BAD, GRID, INK, INK_2, INK_3, LINE, LINE_STRONG, ON_DARK, ON_PALE, Rgb, SHADE, SURFACE, TOKENS, Token,
    WHITE,
};
pub use hatch::Hatch;
pub use mark::Mark;
pub use stage::{STAGES, Stage, label, stage};
pub use style::{Fill, Series, Stroke, Style, TextStyle, series};

pub(crate) use hatch::lines;
