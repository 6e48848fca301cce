//! Plots: a layout in shares of a plot's width and height that every sheet can draw.
//!
//! ```text
//! analysis value ── a kind (crate::drawing) ── Figure { legend, plots, notes } ─┬─ sheet::page ── SVG in HTML
//!                                                                              └─ sheet::file ── SVG, PNG, PDF, text
//! ```
//!
//! A kind of figure is one function that makes [`Plot`]s: it chooses the scales, and places [`Item`]s by them. Positions are
//! shares from the left and from the top, not pixels or points ([`Plot::at`] computes them from values). Lengths that stay the
//! same when the plot grows (marks, caps, distances of text) are given in points or in the type size, in addition to the share.
//! The look of an item is a [`Style`](crate::look::Style), which has a class for pages and literal attributes for files.
//!
//! ```
//! use peernet_figures::look::Style;
//! use peernet_figures::plot::{Axis, Item, Plot};
//! use peernet_figures::scale::Scale;
//! use peernet_figures::sheet::page;
//!
//! let x = Axis::new(Scale::from_zero((0.0, 9.0)), "Upload", "ms");
//! let y = Axis::new(Scale::from_zero((0.0, 40.0)).whole(), "Iterations", "").with_grid();
//! let mut plot = Plot::new(x, y);
//! let (from, to) = (plot.at(2.0, 0.0), plot.at(3.0, 25.0));
//! plot.items.push(Item::rect(from, to, Style::total().bin()));
//! let html = page::plot(&plot, "histogram", "25 uploads took 2 to 3 ms");
//! assert!(html.contains("class=\"bin f-total\""));
//! ```
//!
//! # Moving a figure of a page
//!
//! 1. Write `impl From<view value>` or a constructor for the kind's value in `crate::drawing` where files have the kind too (histogram,
//!    stack, scatter, lengths, course); else a function beside the view that returns a [`Plot`] or a list of items.
//! 2. Scales: `Scale::fit(largest, ticks)`, `Ruler::from_zero` and `Horizontal::Linear` are `Scale::linear((0, largest)).widened(ticks)`;
//!    `Ruler::around(lo, hi, ticks)` is `Scale::linear((lo, hi)).widened(ticks)`, `both_sides` adds `.signed()`;
//!    `Horizontal::Logarithmic` is `Scale::logarithmic`. `Scale::at` is from 0 to 1 and upwards: [`Plot::at`] inverts it.
//! 3. Paths: `pen::line`, `band`, `area`, `dots`, `whiskers` and `ticks` are the constructors of [`Path`].
//! 4. Text that must fit: [`Label::fits_within`], measured in the font itself.
//! 5. Draw it with [`page::plot`](crate::sheet::page::plot) (axes at both sides), [`page::picture`](crate::sheet::page::picture)
//!    (items alone: bars, sparklines, tracks) or [`page::axis`](crate::sheet::page::axis) (the row of labels above bars), and put the
//!    result into the page's template as safe HTML.

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
