//! Several quantities over one stretch of time, under each other.

use askama::Template;

use super::{Percent, Ruler};

/// Tracks under a rail of signs and strips of states, with one time axis.
#[derive(Clone, Debug, Default, PartialEq, Template)]
#[template(path = "svg/tracks.html")]
pub(crate) struct Tracks {
    /// Description of the plot in words.
    pub label: String,
    pub signs: Vec<RailSign>,
    pub gaps: Vec<Gap>,
    pub strips: Vec<Strip>,
    pub tracks: Vec<Track>,
    /// Positions and labels of the time axis; every second one may be left out.
    pub times: Vec<(Percent, String)>,
}

impl askama::filters::HtmlSafe for Tracks {}

/// An incident on the rail, with its line through all tracks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RailSign {
    pub x: Percent,
    pub sign: &'static str,
    pub tone: &'static str,
    /// `true` if its sign is shown: where many stand together, one is.
    pub shown: bool,
}

/// A stretch without data.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Gap {
    pub x: Percent,
    pub width: Percent,
    pub middle: Percent,
    /// Reason of the gap, where there is room for it.
    pub text: Option<&'static str>,
}

/// States over time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Strip {
    pub segments: Vec<Segment>,
}

/// One state.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Segment {
    pub x: Percent,
    pub width: Percent,
    pub tone: &'static str,
    pub text: Option<String>,
}

impl Segment {
    /// Returns the width of a text on the narrowest desktop plot, percent; on a phone it takes twice as much.
    pub(crate) fn room(text: &str) -> f64 {
        const LETTER: f64 = 1.05;
        const MARGIN: f64 = 2.0;
        MARGIN + LETTER * text.chars().count() as f64
    }

    /// Returns whether there is no room for its text on a phone.
    fn is_short(&self) -> bool {
        self.text.as_deref().is_some_and(|text| self.width.0 < 2.0 * Self::room(text))
    }
}

/// One quantity, or several on one scale.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Track {
    pub title: String,
    /// Description of the lines.
    pub note: String,
    /// `tall` or nothing.
    pub class: &'static str,
    pub ticks: Vec<(Percent, String)>,
    pub curves: Vec<Curve>,
    /// Text at the upper end when values lie beyond it.
    pub beyond: Option<String>,
}

/// One path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Curve {
    pub class: &'static str,
    pub path: String,
}

impl Track {
    /// Returns a track on that scale.
    pub(crate) fn new(title: String, ruler: &Ruler) -> Self {
        Self { title, note: String::new(), class: "", ticks: ruler.ticks(), curves: Vec::new(), beyond: None }
    }

    /// Returns the ticks, where there is something to read off: an axis of nothing would be made up.
    fn scale(&self) -> &[(Percent, String)] {
        if self.curves.is_empty() { &[] } else { &self.ticks }
    }

    /// Adds a path; one without points is left out.
    pub(crate) fn draw(&mut self, class: &'static str, path: String) {
        if !path.is_empty() {
            self.curves.push(Curve { class, path });
        }
    }
}
