//! Throughputs of the two directions, as far as their delays are known.

use peernet_aggregator::Window;
use peernet_clock::Verdict;
use peernet_logger::stream::PlacementKind;

use super::clocks;
use super::now::Cell;
use crate::numbers::throughput;

/// A direction of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    Up,
    Down,
}

impl Way {
    const fn delay(self) -> &'static str {
        match self {
            Self::Up => "upload",
            Self::Down => "download",
        }
    }

    /// Name of the throughput's node.
    pub(crate) const fn throughput(self) -> &'static str {
        match self {
            Self::Up => "upload-throughput",
            Self::Down => "download-throughput",
        }
    }
}

/// Why there is no single figure for a direction; `None` when there is one.
pub(crate) fn obstacle(window: &Window, way: Way) -> Option<&'static str> {
    let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
    match bound.and_then(clocks::verdict) {
        Some(Verdict::Ok) => None,
        Some(Verdict::Limited) => Some("known only within its clock bound"),
        Some(_) => Some("the clocks do not tell this direction's delay"),
        None if window.counts.ok == 0 => Some("no successful iteration in this time"),
        None => Some("nothing was sent in this direction"),
    }
}

/// The throughput of a direction in MB/s; over a delay that is known within a wide bound, the interval.
pub(crate) fn cell(kind: PlacementKind, window: &Window, way: Way) -> Cell {
    if kind == PlacementKind::Local {
        return Cell::none("one host: nothing is sent");
    }
    let value = window.value(way.throughput());
    match (obstacle(window, way), value) {
        (None, Some(figures)) => Cell::new(throughput(figures.mean)),
        (None, None) => Cell::none("no throughput was computed"),
        (Some(why), value) => {
            let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
            let half = bound.and_then(|bound| bound.half_width).map(|width| width.p50);
            let delay = window.value(way.delay()).map(|figures| figures.mean);
            match value.zip(half.zip(delay)) {
                Some((value, (half, delay))) if half < delay => {
                    let (lo, hi) = (value.mean * delay / (delay + half), value.mean * delay / (delay - half));
                    Cell {
                        text: format!("{} – {}", throughput(lo), throughput(hi)),
                        title: Some(why.to_owned()),
                    }
                }
                _ => Cell::none(why),
            }
        }
    }
}
