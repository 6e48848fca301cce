//! One iteration as bars under each other, and as two rails with the messages between them.

use askama::Template;
use peernet_statistics::number::stage_ms;

use super::{Percent, Scale};
use crate::look;
use crate::timeline::{NodeLocation, Placed, Timeline, Visit};

/// Narrower bars would not be seen.
const THINNEST: f64 = 0.2;
/// Distance from the bar's end from which on a note fits behind the median's tick.
const NOTE_FITS: f64 = 14.0;

/// The bar of one node.
#[derive(Clone, Debug, Default, PartialEq, Template)]
#[template(path = "svg/waterfall_row.html")]
pub(crate) struct WaterfallRow {
    look: &'static str,
    child: bool,
    grid: Vec<Percent>,
    bands: Vec<(Percent, Percent)>,
    bar: Option<(Percent, Percent)>,
    /// Outline of the interval in which it lies, when its position is not known.
    ghost: Option<(Percent, Percent)>,
    median: Option<(Percent, Option<String>)>,
    whisker: Option<(Percent, Percent)>,
}

impl askama::filters::HtmlSafe for WaterfallRow {}

/// Both hosts as rails.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/lanes.html")]
pub(crate) struct LaneDiagram {
    label: String,
    grid: Vec<Percent>,
    bands: Vec<(Percent, Percent)>,
    edge: Vec<(&'static str, Percent, Percent)>,
    cloud: Vec<(&'static str, Percent, Percent)>,
    up: (Percent, Percent),
    down: Option<(Percent, Percent)>,
}

impl askama::filters::HtmlSafe for LaneDiagram {}

fn at(scale: &Scale, seconds: f64) -> Percent {
    scale.at(seconds * 1e3)
}

fn stretch(scale: &Scale, start: f64, length: f64) -> (Percent, Percent) {
    let (from, to) = (at(scale, start), at(scale, start + length.max(0.0)));
    (from, Percent((to.0 - from.0).max(THINNEST)))
}

/// Returns the strips in which a host's stay may shift: around its arrival and around its answer.
fn bands(visit: &Visit, scale: &Scale) -> Vec<(Percent, Percent)> {
    let (earlier, later) = visit.shift;
    if later - earlier <= 0.0 {
        return Vec::new();
    }
    let ends = [Some(visit.arrived), visit.answered.map(|(left, _)| left)];
    ends.into_iter().flatten().map(|end| stretch(scale, end + earlier, later - earlier)).collect()
}

impl WaterfallRow {
    /// Returns the bar of a node; `tick` marks the run's median in it.
    pub(crate) fn new(node: &Placed, timeline: &Timeline, scale: &Scale, tick: bool) -> Self {
        let visit = timeline.visit();
        let away = node.at != NodeLocation::Host(0);
        let ends = visit.map(|visit| match node.name.as_str() {
            "download" => {
                (visit.answered.map_or(visit.arrived, |(left, _)| left), visit.answered.map(|(_, back)| back))
            }
            _ => (visit.left, Some(visit.arrived)),
        });
        let bar = node.start.zip(node.length).map(|(start, length)| stretch(scale, start, length));
        let unknown = node.at == NodeLocation::Network && node.length.is_none();
        let ghost = ends.filter(|_| unknown).and_then(|(from, to)| Some(stretch(scale, from, to? - from)));
        let median =
            node.start.zip(node.length).zip(node.median).filter(|_| tick).map(|((start, length), median)| {
                let x = at(scale, start + median);
                let room = at(scale, start + length).0 - x.0;
                (x, (room > NOTE_FITS).then(|| format!("median {}", stage_ms(median))))
            });
        // The whisker is drawn at the message's uncertain end: an upload ends there, a download begins there.
        let whisker = node.delay.and_then(|delay| delay.bounds).zip(visit).filter(|((lo, hi), _)| hi > lo);
        let whisker = whisker.and_then(|((lo, hi), visit)| match node.name.as_str() {
            "download" => {
                let (_, back) = visit.answered?;
                Some((at(scale, back - hi), at(scale, back - lo)))
            }
            _ => Some((at(scale, visit.left + lo), at(scale, visit.left + hi))),
        });
        Self {
            look: look::class(&node.name),
            child: node.depth > 0,
            grid: scale.grid(),
            bands: visit.filter(|_| away).map(|visit| bands(visit, scale)).unwrap_or_default(),
            bar,
            ghost,
            median,
            whisker,
        }
    }

    /// Returns the bar of the whole.
    pub(crate) fn total(seconds: f64, scale: &Scale) -> Self {
        Self { look: "total", grid: scale.grid(), bar: Some(stretch(scale, 0.0, seconds)), ..Self::default() }
    }

    /// Returns a row without a bar.
    pub(crate) fn blank(scale: &Scale) -> Self {
        Self { grid: scale.grid(), ..Self::default() }
    }
}

impl LaneDiagram {
    /// Returns the rails of an iteration that went to exactly one other host.
    pub(crate) fn new(timeline: &Timeline, label: String, scale: &Scale) -> Option<Self> {
        let visit = timeline.visit()?;
        let on = |host: u8| {
            let nodes = timeline
                .nodes
                .iter()
                .filter(move |node| node.depth == 0 && node.at == NodeLocation::Host(host));
            let bars = nodes.filter_map(|node| {
                let (x, width) = stretch(scale, node.start?, node.length?);
                Some((look::class(&node.name), x, width))
            });
            bars.collect()
        };
        Some(Self {
            label,
            grid: scale.grid(),
            bands: bands(visit, scale),
            edge: on(0),
            cloud: on(1),
            up: (at(scale, visit.left), at(scale, visit.arrived)),
            down: visit.answered.map(|(left, back)| (at(scale, left), at(scale, back))),
        })
    }
}
