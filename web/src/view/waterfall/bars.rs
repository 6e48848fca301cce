//! Pictures of one iteration: a bar for each node, and two horizontal rails (edge and cloud) with the messages between
//! them.

use peernet_figures::drawing::Orientation;
use peernet_figures::look::{Style, stage};
use peernet_figures::plot::{At, Item, Label};
use peernet_figures::scale::Scale;
use peernet_statistics::number::is_exact;

use crate::picture::Picture;
use crate::timeline::{NodeLocation, PlacedNode, Timeline, Visit};

/// Minimum width of a bar, as a share of the axis; narrower bars would be invisible.
const MIN_WIDTH: f64 = 0.002;
/// Upper and lower side of a bar, as shares of the height of the picture.
const BAR: (f64, f64) = (0.24, 0.76);
/// Upper and lower side of the bar of a child node.
const CHILD: (f64, f64) = (0.3, 0.7);
/// Half the length of the caps of a clock bound, points: in a bar, and below a rail.
const CAPS: (f64, f64) = (3.8, 2.6);
/// Vertical positions of the rails of edge and cloud, as shares of the height of the picture.
const RAILS: (f64, f64) = (0.24, 0.76);
/// Half the height of a bar on a rail.
const HALF_HEIGHT: f64 = 0.12;
/// Vertical position of the clock bounds, below the cloud's rail.
const BOUNDS: f64 = 0.94;
/// Both ends of a clock bound have caps.
const HAS_CAP: [bool; 2] = [true; 2];
/// The bar of a row has no label, because the row contains the numbers.
const NO_LABEL: &str = "";

/// Returns the position of a time on the axis.
fn at(scale: &Scale, seconds: f64) -> f64 {
    scale.at(seconds * 1e3)
}

/// Returns the positions of the beginning and the end of a bar.
fn extent(scale: &Scale, start: f64, length: f64) -> (f64, f64) {
    let (from, to) = (at(scale, start), at(scale, start + length.max(0.0)));
    (from, to.max(from + MIN_WIDTH))
}

fn rect((from, to): (f64, f64), (top, bottom): (f64, f64), style: Style) -> Item {
    Item::rect(At::new(from, top), At::new(to, bottom), style)
}

/// Returns the uncertain times of a visit: the ranges in which the arrival of the request and the departure of the
/// answer may lie.
fn bands(visit: &Visit, scale: &Scale) -> Vec<(f64, f64)> {
    let (earlier, later) = visit.shift;
    if later - earlier <= 0.0 {
        return Vec::new();
    }
    let times = [Some(visit.arrival), visit.answer_times.map(|(sent_at, _)| sent_at)];
    times.into_iter().flatten().map(|time| extent(scale, time + earlier, later - earlier)).collect()
}

/// Returns a row without a bar.
pub(super) fn blank(scale: &Scale) -> Picture {
    Picture::of_items(&Item::grid(scale), "row", NO_LABEL)
}

/// Returns the bar of the total.
pub(super) fn total(seconds: f64, scale: &Scale) -> Picture {
    let mut items = Item::grid(scale);
    items.push(rect(extent(scale, 0.0, seconds), BAR, Style::total()));
    Picture::of_items(&items, "row", NO_LABEL)
}

/// Returns the bar of a node. If `has_median` is true, a tick marks the run's median.
pub(super) fn row(node: &PlacedNode, timeline: &Timeline, scale: &Scale, has_median: bool) -> Picture {
    let (visit, look) = (timeline.visit(), stage(&node.name));
    let mut items = Item::grid(scale);
    if let Some(visit) = visit.filter(|_| node.location != NodeLocation::Host(0)) {
        items.extend(
            bands(visit, scale).into_iter().map(|band| rect(band, (0.0, 1.0), Style::of_page("band"))),
        );
    }
    let is_download = node.name == "download";
    if let Some((start, length)) = node.start.zip(node.length) {
        let sides = if node.depth > 0 { CHILD } else { BAR };
        items.push(rect(extent(scale, start, length), sides, look.plain()));
    } else if let Some(visit) =
        visit.filter(|_| node.location == NodeLocation::Network && node.length.is_none())
    {
        // The duration of the message is unknown. The outline shows the time in which the message was on the way: one
        // end is known, and the end on the cloud is an estimate.
        let ends = if is_download { visit.answer_times } else { Some((visit.sent_at, visit.arrival)) };
        let ghost = ends.map(|(from, to)| rect(extent(scale, from, to - from), BAR, Style::of_page("ghost")));
        items.extend(ghost);
    }
    if let Some(((start, length), median)) =
        node.start.zip(node.length).zip(node.median).filter(|_| has_median)
    {
        let x = at(scale, start + median);
        items.push(Item::line(At::new(x, 0.08), At::new(x, 0.92), Style::of_page("medtick")));
        let label = Label::new(
            At::new(x, 0.5),
            format!("median {}", timeline.duration_format().duration(median)),
            look.text(),
        );
        items.push(Item::Text(label.shifted(0.5, 0.36).with_max_width(at(scale, start + length) - x)));
    }
    // The uncertain end of a message is on the cloud: the arrival of an upload, the departure of a download. The
    // whisker is drawn there.
    let bounds = node.delay.and_then(|delay| delay.bounds).filter(|(lo, hi)| !is_exact(hi - lo)).zip(visit);
    let ends = bounds.and_then(|((lo, hi), visit)| match visit.answer_times {
        Some((_, back)) if is_download => Some([back - hi, back - lo]),
        None if is_download => None,
        _ => Some([visit.sent_at + lo, visit.sent_at + hi]),
    });
    if let Some(ends) = ends {
        let ends = ends.map(|end| At::new(at(scale, end), 0.5));
        items.extend(Orientation::Horizontal.rimmed_whisker(ends, HAS_CAP, CAPS.0));
    }
    Picture::of_items(&items, "row", NO_LABEL)
}

/// Returns the rails of an iteration that went to exactly one other host; `label` describes them in words.
pub(crate) fn rails(timeline: &Timeline, label: &str, scale: &Scale) -> Option<Picture> {
    let visit = timeline.visit()?;
    let (edge, cloud) = RAILS;
    let bands = bands(visit, scale);
    let mut items = Item::grid(scale);
    items.extend(bands.iter().map(|band| rect(*band, (0.5, 1.0), Style::of_page("band"))));
    items.extend([edge, cloud].map(|y| Item::line(At::new(0.0, y), At::new(1.0, y), Style::rail())));
    let hop = |(sent_at, from_y): (f64, f64), (received_at, to_y): (f64, f64), class| {
        Item::line(
            At::new(at(scale, sent_at), from_y),
            At::new(at(scale, received_at), to_y),
            Style::of_page(class),
        )
    };
    items.push(hop((visit.sent_at, edge), (visit.arrival, cloud), "hop h-up"));
    items.extend(
        visit
            .answer_times
            .map(|(sent_at, received_at)| hop((sent_at, cloud), (received_at, edge), "hop h-down")),
    );
    for (host, y) in [(0, edge), (1, cloud)] {
        let nodes =
            timeline.nodes.iter().filter(|node| node.depth == 0 && node.location == NodeLocation::Host(host));
        items.extend(nodes.filter_map(|node| {
            let ends = extent(scale, node.start?, node.length?);
            Some(rect(ends, (y - HALF_HEIGHT, y + HALF_HEIGHT), stage(&node.name).plain()))
        }));
    }
    for (from, to) in bands {
        let ends = [from, to].map(|x| At::new(x, BOUNDS));
        items.extend(Orientation::Horizontal.whisker(ends, HAS_CAP, CAPS.1, &Style::whisker()));
    }
    Some(Picture::of_items(&items, "lane", label))
}
