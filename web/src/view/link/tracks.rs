//! Tracks: charts of several quantities below each other, with one time axis.

use askama::Template;
use peernet_figures::look::{Style, TextStyle};
use peernet_figures::plot::{Anchor, At, Item, Label, Path};
use peernet_figures::scale::{Scale, Tick};

use crate::picture::Picture;

/// Tracks with one time axis. Above the tracks are a row with signs of incidents, and a strip with the verdicts of each
/// direction.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "pages/tracks.html")]
pub(crate) struct Tracks {
    /// Description of the plot in words.
    pub(super) label: String,
    pub(super) signs: Vec<IncidentSign>,
    /// Position of the middle of a gap, and its label.
    pub(super) gap_labels: Vec<(AxisPosition, &'static str)>,
    pub(super) strips: Vec<Picture>,
    pub(super) tracks: Vec<TrackPicture>,
    pub(super) times: Picture,
}

impl askama::filters::HtmlSafe for Tracks {}

/// Position on the time axis, as a share of its length.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(super) struct AxisPosition(pub(super) f64);

impl std::fmt::Display for AxisPosition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3}%", self.0 * 100.0)
    }
}

/// Sign of an incident above the tracks, with a line through all tracks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct IncidentSign {
    pub(super) x: AxisPosition,
    /// Name of the icon.
    pub(super) sign: &'static str,
    /// CSS class of the tone.
    pub(super) tone: &'static str,
    /// `true` if the icon is drawn in addition to the line. If icons would overlap, only the first icon is drawn.
    pub(super) is_shown: bool,
}

/// Chart of one quantity, or of several quantities on one scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Track {
    pub(super) title: String,
    /// Description of the lines.
    pub(super) note: String,
    /// CSS class: `tall`, or empty for a track of the usual height.
    pub(super) class: &'static str,
    scale: Scale,
    lines: Vec<Item>,
    /// Text at the upper end of the track about values beyond the scale; `None` if there are no such values.
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

/// Returns a rectangle from one time to another, as high as the picture.
pub(super) fn span((from, to): (f64, f64), class: &'static str) -> Item {
    Item::rect(At::new(from, 0.0), At::new(to, 1.0), Style::of_page(class))
}

impl Track {
    /// Creates a track without lines.
    pub(super) fn new(title: String, scale: Scale) -> Self {
        Self { title, note: String::new(), class: "", scale, lines: Vec::new(), beyond: None }
    }

    /// Adds a path, unless it has no points.
    pub(super) fn draw(&mut self, class: &'static str, path: Path) {
        if !path.is_empty() {
            self.lines.push(Item::path(path, Style::of_page(class)));
        }
    }

    /// Draws the track over the background: the gaps and the lines of incidents.
    pub(super) fn picture(self, background: &[Item]) -> TrackPicture {
        // Without data the scale has no meaning, so the axis has no labels.
        let ticks: Vec<Tick> = if self.lines.is_empty() { Vec::new() } else { self.scale.ticks(6) };
        let mut items: Vec<Item> = Vec::new();
        if self.lines.is_empty() {
            let no_data_label = Label::new(At::new(0.5, 0.5), "nothing known in this time", TextStyle::AXIS);
            items.push(Item::Text(no_data_label.anchored(Anchor::Middle)));
        }
        let grid_line = |at: f64| Item::line(At::new(0.0, at), At::new(1.0, at), Style::grid());
        items.extend(ticks.iter().map(|tick| grid_line(1.0 - tick.at)));
        items.extend(background.iter().cloned());
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
