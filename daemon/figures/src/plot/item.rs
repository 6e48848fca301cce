//! Items of a plot: shapes, lines and text.

use super::axis::MAX_MARKS;
use super::path::Path;
use crate::look::{Mark, Style, TextStyle};
use crate::scale::Scale;
use crate::text;

/// Place in a plot: shares of its width from the left and of its height from the top, and an offset in points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct At {
    /// Share from the left.
    pub x: f64,
    /// Share from the top.
    pub y: f64,
    /// Offset to the right, points.
    pub dx: f64,
    /// Offset downwards, points.
    pub dy: f64,
}

impl At {
    /// Returns a place without an offset.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y, dx: 0.0, dy: 0.0 }
    }

    /// Returns the place that is `dx` points to the right of this place and `dy` points below it, whatever the size of
    /// the plot.
    #[must_use]
    pub fn offset_by(self, dx: f64, dy: f64) -> Self {
        Self { dx: self.dx + dx, dy: self.dy + dy, ..self }
    }
}

/// Part of a text that lies at the text's place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Beginning of the text.
    Start,
    /// Middle of the text.
    Middle,
    /// End of the text.
    End,
}

impl Anchor {
    /// Returns the name in SVG.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }
}

/// Line of text.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Place of the text.
    pub at: At,
    /// Offset from the place to the baseline, to the right and downwards, as multiples of the type size.
    pub shift: (f64, f64),
    /// Part of the text that lies at the place.
    pub anchor: Anchor,
    /// The text.
    pub text: String,
    /// Look.
    pub style: TextStyle,
    /// Minimum width of a picture in which a page shows the text, rem. With 0, the text is always shown; with `None`,
    /// the text is never shown.
    pub min_width: Option<u16>,
    /// Text before this text, and the minimum width of a picture in which a page shows both. Files do not show the text
    /// before it.
    pub prefix: Option<(String, Option<u16>)>,
}

/// Distance from the middle of capital letters down to their baseline, as a share of the type size.
const MIDDLE: f64 = 0.36;

impl Label {
    /// Returns a text that begins at a place and is vertically centred at this place.
    pub fn new(at: At, text: impl Into<String>, style: TextStyle) -> Self {
        let text = text.into();
        Self {
            at,
            shift: (0.0, MIDDLE),
            anchor: Anchor::Start,
            text,
            style,
            min_width: Some(0),
            prefix: None,
        }
    }

    /// Returns the same text, of which this part lies at the place.
    #[must_use]
    pub fn anchored(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// Returns the same text with another offset from the place to the baseline, as multiples of the type size.
    #[must_use]
    pub fn shifted(self, right: f64, down: f64) -> Self {
        Self { shift: (right, down), ..self }
    }

    /// Returns the same text with another text before it. A page shows the text before it only if there is room for
    /// both.
    #[must_use]
    pub fn with_prefix(self, prefix: String) -> Self {
        Self { prefix: Some((prefix, Some(0))), ..self }
    }

    /// Returns the same text with a limit on its width: a page shows the text only if the text takes at most the share
    /// `share` of the picture's width. If the method is called several times, the smallest share applies.
    #[must_use]
    pub fn with_max_width(self, share: f64) -> Self {
        // Returns the minimum width that satisfies the earlier limits and this limit; `None` if no picture is wide
        // enough.
        let raised_min_width = |min_width: Option<u16>, text: &str| {
            Some(min_width?.max(text::width_step(text::width_rem(text) / share.max(1e-9))?))
        };
        let prefix = self.prefix.map(|(prefix, min_width)| {
            let min_width = raised_min_width(min_width, &format!("{prefix}{}", self.text));
            (prefix, min_width)
        });
        Self { min_width: raised_min_width(self.min_width, &self.text), prefix, ..self }
    }

    /// Returns the left end, top, right end and bottom of the text, as distances from its place in points. `size` is
    /// the type size in points.
    pub fn extent(&self, size: f64) -> [f64; 4] {
        let width = text::width(&self.text, size);
        let left = match self.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -width / 2.0,
            Anchor::End => -width,
        } + self.shift.0 * size;
        let baseline = self.shift.1 * size;
        // Room for capital letters above the baseline and for descenders below it.
        [left, baseline - 0.75 * size, left + width, baseline + 0.22 * size]
    }
}

/// Something that is drawn in a plot.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// Rectangle between two corners. In a file, the rectangle has a minimum width and height, so that it is visible.
    Rect {
        /// Any corner.
        from: At,
        /// Opposite corner.
        to: At,
        /// Minimum width and height in a file, points.
        min_size: (f64, f64),
        /// Look.
        style: Style,
    },
    /// Straight line.
    Line {
        /// One end.
        from: At,
        /// Other end.
        to: At,
        /// Look.
        style: Style,
    },
    /// Lines and areas of many points.
    Path {
        /// Path to draw.
        path: Path,
        /// Look.
        style: Style,
    },
    /// Point with a mark.
    Mark {
        /// Middle of the mark.
        at: At,
        /// Shape of the mark.
        mark: Mark,
        /// Radius of the mark, points.
        radius: f64,
        /// Look.
        style: Style,
    },
    /// Line of text.
    Text(Label),
}

impl Item {
    /// Returns a rectangle of any size.
    pub fn rect(from: At, to: At, style: Style) -> Self {
        Self::Rect { from, to, min_size: (0.0, 0.0), style }
    }

    /// Returns a straight line.
    pub fn line(from: At, to: At, style: Style) -> Self {
        Self::Line { from, to, style }
    }

    /// Returns a path.
    pub fn path(path: Path, style: Style) -> Self {
        Self::Path { path, style }
    }

    /// Returns a point.
    pub fn mark(at: At, mark: Mark, radius: f64, style: Style) -> Self {
        Self::Mark { at, mark, radius, style }
    }

    /// Returns upright lines at the ticks of a horizontal scale.
    pub fn grid(scale: &Scale) -> Vec<Self> {
        let line = |at: f64| Self::line(At::new(at, 0.0), At::new(at, 1.0), Style::grid());
        scale.ticks(MAX_MARKS).into_iter().map(|tick| line(tick.at)).collect()
    }

    /// Returns an upright whisker between two places. `has_cap` says which of its two ends have a cap. A cap extends
    /// `cap` points to each side. An end at which the whisker leaves the plot should have no cap.
    pub fn whisker([from, to]: [At; 2], has_cap: [bool; 2], cap: f64, style: &Style) -> Vec<Self> {
        let mut items = vec![Self::line(from, to, style.clone())];
        for (end, _) in [from, to].into_iter().zip(has_cap).filter(|(_, has_cap)| *has_cap) {
            items.push(Self::line(end.offset_by(-cap, 0.0), end.offset_by(cap, 0.0), style.clone()));
        }
        items
    }
}
