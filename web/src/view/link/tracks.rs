//! Tracks: several quantities over one stretch of time, under each other.

use askama::Template;
use peernet_figures::look::{Style, TextStyle};
use peernet_figures::plot::{Anchor, At, Item, Label, Path};
use peernet_figures::scale::{Scale, Tick};

use crate::picture::Picture;

/// Tracks under a rail of signs and strips of states, with one time axis.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "pages/tracks.html")]
pub(crate) struct Tracks {
    /// Description of the plot in words.
    pub(super) label: String,
    pub(super) signs: Vec<RailSign>,
    /// Places and reasons of stretches without data.
    pub(super) reasons: Vec<(Place, &'static str)>,
    pub(super) strips: Vec<Picture>,
    pub(super) tracks: Vec<TrackPicture>,
    pub(super) times: Picture,
}

impl askama::filters::HtmlSafe for Tracks {}

/// Place along the time axis, as a share.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(super) struct Place(pub(super) f64);

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3}%", self.0 * 100.0)
    }
}

/// An incident on the rail, with its line through all tracks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RailSign {
    pub(super) x: Place,
    pub(super) sign: &'static str,
    pub(super) tone: &'static str,
    /// `true` if its sign is shown: where many stand together, one is.
    pub(super) is_shown: bool,
}

/// One quantity, or several on one scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Track {
    pub(super) title: String,
    /// Description of the lines.
    pub(super) note: String,
    /// `tall` or nothing.
    pub(super) class: &'static str,
    scale: Scale,
    lines: Vec<Item>,
    /// Text at the upper end when values lie beyond it.
    pub(super) beyond: Option<String>,
}

/// A track with its axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TrackPicture {
    title: String,
    note: String,
    pub(super) axis: Picture,
    pub(super) plot: Picture,
}

/// Returns a span of time in the full height of a picture.
pub(super) fn span((from, to): (f64, f64), class: &'static str) -> Item {
    Item::rect(At::new(from, 0.0), At::new(to, 1.0), Style::of_page(class))
}

impl Track {
    /// Returns a track on that scale.
    pub(super) fn new(title: String, scale: Scale) -> Self {
        Self { title, note: String::new(), class: "", scale, lines: Vec::new(), beyond: None }
    }

    /// Adds a path; one without points is left out.
    pub(super) fn draw(&mut self, class: &'static str, path: Path) {
        if !path.is_empty() {
            self.lines.push(Item::path(path, Style::of_page(class)));
        }
    }

    /// Draws it over the stretches without data and the lines of incidents.
    pub(super) fn picture(self, ground: &[Item]) -> TrackPicture {
        // An axis of nothing would be made up.
        let ticks: Vec<Tick> = if self.lines.is_empty() { Vec::new() } else { self.scale.ticks(6) };
        let mut items: Vec<Item> = Vec::new();
        if self.lines.is_empty() {
            let nothing = Label::new(At::new(0.5, 0.5), "nothing known in this time", TextStyle::AXIS);
            items.push(Item::Text(nothing.anchored(Anchor::Middle)));
        }
        let level = |at: f64| Item::line(At::new(0.0, at), At::new(1.0, at), Style::grid());
        items.extend(ticks.iter().map(|tick| level(1.0 - tick.at)));
        items.extend(ground.iter().cloned());
        items.extend(self.lines);
        items.extend(self.beyond.map(|words| {
            let label = Label::new(At::new(1.0, 0.0), words, TextStyle::BEYOND).anchored(Anchor::End);
            Item::Text(label.shifted(-0.4, 1.2))
        }));
        TrackPicture {
            title: self.title,
            note: self.note,
            axis: Picture::labels_beside(&format!("yaxis {}", self.class), &ticks),
            plot: Picture::of_items(&items, &format!("plot {}", self.class), ""),
        }
    }
}
