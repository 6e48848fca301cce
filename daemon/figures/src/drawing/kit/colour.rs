//! The colours of the dashboard on paper: Okabe–Ito hues, told apart with every kind of colour vision.

use plotters::style::RGBColor;

/// Edge to cloud.
pub const UPLOAD: RGBColor = RGBColor(0xd5, 0x5e, 0x00);
/// Cloud to edge.
pub const DOWNLOAD: RGBColor = RGBColor(0xae, 0x54, 0x85);
/// Text, and whatever is no stage.
pub const INK: RGBColor = RGBColor(0x14, 0x18, 0x1f);

/// Quiet text.
pub(in crate::drawing) const QUIET: RGBColor = RGBColor(0x45, 0x4d, 0x59);
/// Lines of a grid.
pub(in crate::drawing) const GRID: RGBColor = RGBColor(0xdd, 0xe2, 0xe8);
/// Axes.
pub(in crate::drawing) const AXIS: RGBColor = RGBColor(0x8a, 0x94, 0xa3);
/// What is left out.
pub(in crate::drawing) const SHADE: RGBColor = RGBColor(0xe8, 0xeb, 0xef);
/// Series side by side (Okabe and Ito).
pub(in crate::drawing) const SERIES: [RGBColor; 4] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
];
