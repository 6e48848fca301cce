//! Plots: a layout in shares of a plot's width and height, which both renderers (`render::page`, `render::file`) can
//! draw.
//!
//! ```text
//! analysis value ── a kind (crate::drawing) ── Figure { legend, plots, notes } ─┬─ render::page ── SVG in HTML
//!                                                                              └─ render::file ── SVG, PNG, PDF, text
//! ```
//!
//! A kind of figure is a function, or a type with a method, that makes [`Plot`]s. The kind chooses the scales and uses
//! them to place [`Item`]s. Positions are neither pixels nor points, but shares of the plot from the left and from the
//! top ([`Plot::at`] computes the shares from values). Lengths that stay the same when the plot grows (marks, caps,
//! distances of text) are given in points or as multiples of the type size. The look of an item is a
//! [`Style`](crate::look::Style), which has a class for pages and literal attributes for files.
//!
//! ```
//! use peernet_figures::look::Style;
//! use peernet_figures::plot::{Axis, Item, Plot};
//! use peernet_figures::scale::Scale;
//! use peernet_figures::render::page;
//!
//! let x = Axis::new(Scale::from_zero((0.0, 9.0)), "Upload", "ms");
//! let y = Axis::new(Scale::from_zero((0.0, 40.0)).whole(), "Iterations", "").with_grid();
//! let mut plot = Plot::new(x, y);
//! let (from, to) = (plot.at(2.0, 0.0), plot.at(3.0, 25.0));
//! plot.items.push(Item::rect(from, to, Style::total().bin()));
//! let html = page::plot(&plot, "plot-with-axes", "25 uploads took 2 to 3 ms");
//! assert!(html.contains("class=\"bin f-total\""));
//! ```
//!
//! # Figures of pages
//!
//! A kind of figure that several pages or files show is a type in `crate::drawing`; one of its methods makes the plots.
//! A figure that depends on the types of one page, such as the waterfall of an iteration, is a function in the view of
//! that page and returns [`Item`]s.
//!
//! - [`page::plot`](crate::render::page::plot) draws a plot with both axes.
//! - [`page::picture`](crate::render::page::picture) draws items without axes: bars, sparklines, tracks.
//! - [`page::axis`](crate::render::page::axis) draws the row of labels above bars.
//!
//! [`Label::with_max_width`] hides a text on pages that have too little room for the text. The width of the text is
//! measured in the embedded font.
//! [`Scale::at_or_outside`](crate::scale::Scale::at_or_outside) places a line that may leave its plot.

mod axis;
mod figure;
mod item;
mod legend;
mod path;

pub use axis::{Axis, Marks, Unit};
pub use figure::{Figure, Height, Plot, Strip, Table};
pub use item::{Anchor, At, Item, Label};
pub use legend::{Key, Swatch};
pub use path::{Path, Step};
