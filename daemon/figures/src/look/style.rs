//! Styles: the look of a shape on a page and in a file.

use std::borrow::Cow;

use super::colour::{BAD, GRID, INK, INK_2, LINE_STRONG, ON_PALE, Rgb, SHADE, WHITE};
use super::hatch::Hatch;
use super::mark::Mark;

/// Fill of a shape in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fill {
    /// Colour of the fill.
    pub colour: Rgb,
    /// Opacity from 0 to 1. Pages use the opacity, too, because it represents a number. Pages do not use the colour.
    pub opacity: f64,
    /// Lines over the fill, and their colour.
    pub hatch: Option<(Hatch, Rgb)>,
}

impl Fill {
    /// Returns an opaque fill.
    pub const fn of(colour: Rgb) -> Self {
        Self { colour, opacity: 1.0, hatch: None }
    }
}

/// Stroke of a shape in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour of the stroke.
    pub colour: Rgb,
    /// Width, points.
    pub width: f64,
    /// Dash and gap, points; `None` for a solid line.
    pub dash: Option<(f64, f64)>,
}

/// Look of a shape: its class on a page, its fill and its stroke in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    /// Classes of the dashboard's style sheet.
    pub class: Cow<'static, str>,
    /// Fill in a file.
    pub fill: Option<Fill>,
    /// Stroke in a file.
    pub stroke: Option<Stroke>,
}

impl Style {
    /// Returns an area without an edge.
    pub fn area(class: impl Into<Cow<'static, str>>, fill: Fill) -> Self {
        Self { class: class.into(), fill: Some(fill), stroke: None }
    }

    /// Returns a solid line.
    pub fn line(class: impl Into<Cow<'static, str>>, colour: Rgb, width: f64) -> Self {
        Self { class: class.into(), fill: None, stroke: Some(Stroke { colour, width, dash: None }) }
    }

    /// Returns the look of a shape that only pages have.
    pub fn of_page(class: impl Into<Cow<'static, str>>) -> Self {
        Self { class: class.into(), fill: None, stroke: None }
    }

    /// Returns the same line with a dash and a gap, points; with `None`, returns a solid line.
    #[must_use]
    pub fn dashed(mut self, dash: Option<(f64, f64)>) -> Self {
        if let Some(stroke) = &mut self.stroke {
            stroke.dash = dash;
        }
        self
    }

    /// Returns the same area with a thin edge; without a colour, returns the area unchanged.
    #[must_use]
    pub fn edged(self, colour: Option<Rgb>) -> Self {
        let stroke = colour.map(|colour| Stroke { colour, width: 0.3, dash: None });
        Self { stroke: stroke.or(self.stroke), ..self }
    }

    /// Returns the same style with another opacity of the fill, which pages show as well.
    #[must_use]
    pub fn opacity(mut self, opacity: f64) -> Self {
        if let Some(fill) = &mut self.fill {
            fill.opacity = opacity;
        }
        self
    }

    /// Returns the same style with more classes.
    #[must_use]
    pub fn with(self, class: &str) -> Self {
        Self { class: format!("{} {class}", self.class).into(), ..self }
    }

    /// Returns the style of a grid line.
    pub fn grid() -> Self {
        Self::line("gridl", GRID, 0.45)
    }

    /// Returns the style of an axis line.
    pub fn rail() -> Self {
        Self::line("rail", LINE_STRONG.light, 0.45)
    }

    /// Returns the same style for a bar of a distribution. A line in the colour of the background separates the bars.
    #[must_use]
    pub fn bin(self) -> Self {
        let separator = Stroke { colour: WHITE, width: 0.3, dash: None };
        Self { class: format!("bin {}", self.class).into(), stroke: Some(separator), ..self }
    }

    /// Returns the style of a bar that does not belong to a stage.
    pub fn total() -> Self {
        Self::area("f-total", Fill::of(LINE_STRONG.light))
    }

    /// Returns the style of the line of a quantile with this name: `median`, `p95` or `p99`.
    pub fn quantile(name: &'static str) -> Self {
        let (colour, width, dash) = match name {
            "p95" => (INK, 0.8, Some((3.3, 1.8))),
            "p99" => (INK_2, 0.8, Some((0.9, 1.5))),
            _ => (INK, 0.9, None),
        };
        Self::line(format!("mark {name}"), colour.light, width).dashed(dash)
    }

    /// Returns the style of a rim in the colour of the background, which separates a line from the items behind it.
    pub fn halo() -> Self {
        Self::line("halo", WHITE, 2.0)
    }

    /// Returns the style of a rim that is narrower than [`halo`](Self::halo), for lines over bars.
    pub fn rim() -> Self {
        Self::line("rim", WHITE, 1.8)
    }

    /// Returns the style of a whisker.
    pub fn whisker() -> Self {
        Self::line("whisk2", INK.light, 0.75)
    }

    /// Returns the style of a line between neighbours in a stack.
    pub fn cut() -> Self {
        Self::line("cut", WHITE, 0.45)
    }

    /// Returns the style of points that do not belong to a stage.
    pub fn ink() -> Self {
        Self::area("f-ink", Fill::of(INK.light))
    }

    /// Returns the style of a band around a line that does not belong to a stage.
    pub fn band() -> Self {
        Self::area("band", Fill::of(INK.light)).opacity(0.25)
    }

    /// Returns the style of a period that is excluded, such as warm-up.
    pub fn shade() -> Self {
        Self::area("warm-up", Fill::of(SHADE))
    }

    /// Returns the style of the mark of a failed iteration.
    pub fn failed_iteration() -> Self {
        Self::line("lost", BAD.light, 0.9)
    }

    /// Returns the style of a border between episodes.
    pub fn border() -> Self {
        Self::line("border", LINE_STRONG.light, 0.45).dashed(Some((1.5, 1.5)))
    }
}

/// Look of text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextStyle {
    /// Class on a page.
    pub class: &'static str,
    /// Colour in a file.
    pub colour: Rgb,
    /// True if a rim in the colour of the background separates the text from the shapes behind it.
    pub has_halo: bool,
}

impl TextStyle {
    /// Label of an axis. The style sheet of pages selects such a label by its position, so the class is empty.
    pub const AXIS: Self = Self { class: "", colour: INK_2.light, has_halo: false };
    /// Name of a category at an axis.
    pub const NAME: Self = Self { class: "", colour: INK.light, has_halo: false };
    /// Text at a mark in a plot.
    pub const MARK: Self = Self { class: "marktext", colour: INK.light, has_halo: true };
    /// Count of values beyond an axis.
    pub const BEYOND: Self = Self { class: "beyond", colour: INK_2.light, has_halo: true };
    /// Text on a pale fill.
    pub const ON_PALE: Self = Self { class: "", colour: ON_PALE, has_halo: false };
}

/// Look of one of several series: runs, placements, configurations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Series {
    /// Colour of the line and the points: black or a grey.
    pub colour: Rgb,
    /// Colour of the fill of areas.
    pub fill: Rgb,
    /// Mark of the points.
    pub mark: Mark,
    /// Class of the line.
    line_class: &'static str,
    /// Class of the points and areas.
    fill_class: &'static str,
}

/// Returns the look of the series with this index. There are four looks, so the fifth series looks like the first.
pub fn series(index: usize) -> Series {
    // Colours mean stages, directions, verdicts and failures, so series differ by brightness, mark and dash.
    const GREYS: [Rgb; 4] = [INK.light, Rgb::hex(0x7c_8694), Rgb::hex(0x45_4d59), Rgb::hex(0x8a_94a3)];
    const CLASSES: [[&str; 2]; 4] = [
        ["g-series-1", "f-series-1"],
        ["g-series-2", "f-series-2"],
        ["g-series-3", "f-series-3"],
        ["g-series-4", "f-series-4"],
    ];
    const FILLS: [Rgb; 4] = [Rgb::hex(0xb4_b8be), Rgb::hex(0xe6_e9ed), Rgb::hex(0x8d_96a3), WHITE];
    let index = index % GREYS.len();
    let [line_class, fill_class] = CLASSES[index];
    Series { colour: GREYS[index], fill: FILLS[index], mark: Mark::OF_SERIES[index], line_class, fill_class }
}

impl Series {
    /// Returns the style of the series' line, with the dash that belongs to its mark.
    pub fn line(&self, width: f64) -> Style {
        Style::line(self.line_class, self.colour, width).dashed(self.mark.dash())
    }

    /// Returns the style of the series' points.
    pub fn marks(&self) -> Style {
        Style::area(self.fill_class, Fill::of(self.colour))
    }

    /// Returns the style of the series' area: a tint with an edge.
    pub fn shape(&self) -> Style {
        let edge = Stroke { colour: self.colour, width: 0.5, dash: None };
        Style { stroke: Some(edge), ..Style::area(self.fill_class, Fill::of(self.fill)) }
    }
}
