//! One link, an edge's clock and a cloud's, as its page shows it.

pub(crate) mod chart;
pub(crate) mod course;
pub(crate) mod delays;
pub(crate) mod finding;
pub(crate) mod list;
mod offset;
pub(crate) mod origin;
pub(crate) mod panels;
pub(crate) mod stats;
pub(crate) mod table;
mod trend;

use std::sync::Arc;

use peernet_aggregator::{ClockPoint, LinkPicture, LinkRow, Picture};
use peernet_clock::{Offset, Span, Verdict, WallTime};
use peernet_logger::HostId;
use peernet_logger::stream::{Placement, PlacementKind};

use super::speed::Way;
use delays::Delays;

/// Figures are of so many seconds.
const LATELY: Span = Span::from_seconds(10);

/// Between the two names of a link: it cannot occur in either.
pub(crate) const BETWEEN: char = '~';

/// The name of a link in addresses: `EDGE~CLOUD`.
pub(crate) fn name(edge: &str, cloud: &str) -> String {
    format!("{edge}{BETWEEN}{cloud}")
}

/// The address of a link's page.
pub(crate) fn href(edge: &str, cloud: &str) -> String {
    format!("/links/{}", name(edge, cloud))
}

/// The address of the page of the link that a placement uses, if the link is known.
pub(crate) fn of_placement(picture: &Picture, edge: &str, placement: &Placement) -> Option<String> {
    let cloud = placement.peer.as_ref().filter(|_| placement.kind == PlacementKind::Remote)?.as_str();
    find(picture, &name(edge, cloud)).map(|_| href(edge, cloud))
}

/// The link of that name in a picture.
pub(crate) fn find<'a>(picture: &'a Picture, wanted: &str) -> Option<&'a LinkPicture> {
    let (edge, cloud) = wanted.split_once(BETWEEN)?;
    let matches =
        |link: &&LinkPicture| link.edge_name.as_str() == edge && link.live.peer_name.as_str() == cloud;
    picture.links.iter().map(|link| &**link).find(matches)
}

/// What is shown of a link: as it is now, or as it was when it was last heard of.
#[derive(Clone, Debug)]
pub(crate) struct Subject<'a> {
    pub edge: String,
    pub cloud: String,
    pub ids: (HostId, HostId),
    /// `None` for a link that is stored and not in the live picture.
    pub live: Option<&'a LinkPicture>,
    /// The newest point's time, on the edge's wall clock.
    pub end: WallTime,
    /// Whether the edge tells of it now.
    pub connected: bool,
}

impl<'a> Subject<'a> {
    /// A link of the picture.
    pub(crate) fn live(link: &'a LinkPicture) -> Self {
        Self {
            edge: link.edge_name.to_string(),
            cloud: link.live.peer_name.to_string(),
            ids: (link.edge, link.live.peer),
            end: link.history.last().map_or(link.live.now.at, |point| point.at),
            connected: link.connected,
            live: Some(link),
        }
    }

    /// A link that is only stored.
    pub(crate) fn past(row: &LinkRow) -> Self {
        Self {
            edge: row.edge_name.to_string(),
            cloud: row.cloud_name.to_string(),
            ids: (row.edge, row.cloud),
            live: None,
            end: row.last,
            connected: false,
        }
    }

    /// `cam-3 → rack-a`.
    pub(crate) fn route(&self) -> String {
        format!("{} → {}", self.edge, self.cloud)
    }

    /// Whether both hosts read one clock.
    pub(crate) fn same_clock(&self) -> bool {
        self.live.is_some_and(|link| link.live.same_clock)
    }

    /// The last ten minutes.
    pub(crate) fn history(&self) -> &'a [Arc<ClockPoint>] {
        self.live.map_or(&[], |link| link.history.as_slice())
    }

    /// What is known of the offset now.
    pub(crate) fn offset(&self) -> Option<&'a Offset> {
        let link = self.live?;
        link.live.now.offset.as_ref().or_else(|| link.history.last()?.offset.as_ref())
    }

    /// Half the width of the offset's bounds, seconds.
    pub(crate) fn bound(&self) -> Option<f64> {
        if self.same_clock() {
            return Some(0.0);
        }
        Some(self.offset()?.bounds.width().seconds() / 2.0)
    }

    /// The delays of data of the last ten seconds.
    pub(crate) fn delays(&self, way: Way) -> Delays {
        let since = self.end - LATELY;
        Delays::of(
            way,
            self.history().iter().rev().take_while(|point| point.at > since).map(|point| &**point),
        )
    }

    /// The verdict to show for the whole link: the worse of the two directions, else that of the clocks.
    pub(crate) fn verdict(&self) -> Option<Verdict> {
        let directions = [Way::Up, Way::Down].into_iter().filter_map(|way| self.delays(way).verdict);
        let worst = directions.max_by_key(|verdict| super::chip::severity(*verdict));
        worst.or_else(|| match (self.same_clock(), self.offset()) {
            (true, _) => Some(Verdict::Ok),
            (false, Some(offset)) => Some(offset.verdict),
            (false, None) => self.live.map(|_| Verdict::Unsynchronised),
        })
    }

    /// Names of the pipelines that use the link, with the addresses of their pages.
    pub(crate) fn pipelines(&self) -> Vec<(String, String)> {
        let used = self.live.into_iter().flat_map(|link| &link.live.pipelines);
        used.map(|name| (name.to_string(), super::place::pipeline_href(&self.edge, name.as_str()))).collect()
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
