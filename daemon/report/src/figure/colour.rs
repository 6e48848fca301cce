//! The colours of the dashboard on paper: Okabe–Ito hues, told apart with every kind of colour vision.

use plotters::style::RGBColor;

/// Edge to cloud.
pub const UPLOAD: RGBColor = RGBColor(0xd5, 0x5e, 0x00);
/// Cloud to edge.
pub const DOWNLOAD: RGBColor = RGBColor(0xae, 0x54, 0x85);

/// Text.
pub(super) const INK: RGBColor = RGBColor(0x14, 0x18, 0x1f);
/// Quiet text.
pub(super) const QUIET: RGBColor = RGBColor(0x62, 0x6b, 0x78);
/// Lines of a grid.
pub(super) const GRID: RGBColor = RGBColor(0xe3, 0xe7, 0xec);
/// Axes.
pub(super) const AXIS: RGBColor = RGBColor(0x8a, 0x94, 0xa3);
