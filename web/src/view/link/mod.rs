//! One link, an edge and a cloud over one network, as its page shows it.

pub(crate) mod basis;
pub(crate) mod carried;
pub(crate) mod chart;
pub(crate) mod connections;
pub(crate) mod course;
pub(crate) mod delays;
pub(crate) mod finding;
pub(crate) mod list;
mod offset;
pub(crate) mod origin;
pub(crate) mod panels;
pub(crate) mod stats;
pub(crate) mod table;
pub(crate) mod tracks;
mod trend;

use std::sync::Arc;

use peernet_aggregator::{LinkSnapshot, LiveState};
use peernet_clock::{Offset, RelatedClocks, Span, Verdict, WallTime};
use peernet_store::{ClockPoint, DelayAssumptions, LinkKey, LinkRow};
use peernet_stream::{NetworkName, Placement, PlacementKind};

use super::speed::NetworkDirection;
use crate::error::WebError;
use delays::Delays;

/// Time span of the figures.
const LATELY: Span = Span::from_seconds(10);

/// Separator of the parts of a link's name; it cannot occur in any of them.
pub(crate) const BETWEEN: char = '~';

/// Returns the name of a link in addresses: `EDGE~CLOUD` over `zmq-tcp`, as in earlier releases, and `EDGE~CLOUD~NETWORK` over any
/// other network.
pub(crate) fn name(edge: &str, cloud: &str, network: &NetworkName) -> String {
    if network.is_default() {
        format!("{edge}{BETWEEN}{cloud}")
    } else {
        format!("{edge}{BETWEEN}{cloud}{BETWEEN}{network}")
    }
}

/// Returns the name without the network where that is `zmq-tcp`.
pub(crate) fn canonical(wanted: String) -> String {
    match parts(&wanted) {
        Some((edge, cloud, network)) => name(edge, cloud, &network),
        None => wanted,
    }
}

/// Edge, cloud and network of a link's name.
fn parts(wanted: &str) -> Option<(&str, &str, NetworkName)> {
    let (edge, rest) = wanted.split_once(BETWEEN)?;
    match rest.split_once(BETWEEN) {
        Some((cloud, network)) => Some((edge, cloud, network.parse().ok()?)),
        None => Some((edge, rest, NetworkName::default())),
    }
}

/// Returns the address of a link's page.
pub(crate) fn href(edge: &str, cloud: &str, network: &NetworkName) -> String {
    format!("/links/{}", name(edge, cloud, network))
}

/// Returns the address of the page of the link that a placement uses, if the link is known.
pub(crate) fn of_placement(picture: &LiveState, edge: &str, placement: &Placement) -> Option<String> {
    let cloud = placement.peer.as_ref().filter(|_| placement.kind == PlacementKind::Remote)?.as_str();
    let network = placement.network.as_ref().map(|network| network.parse::<NetworkName>());
    let network = network.transpose().ok()?;
    let network = network.unwrap_or_default();
    find(picture, &name(edge, cloud, &network)).map(|_| href(edge, cloud, &network))
}

/// Returns the link of that name in a picture.
pub(crate) fn find<'a>(picture: &'a LiveState, wanted: &str) -> Option<&'a LinkSnapshot> {
    let (edge, cloud, network) = parts(wanted)?;
    let matches = |link: &&LinkSnapshot| {
        link.edge_name.as_str() == edge
            && link.live.peer_name.as_str() == cloud
            && *link.live.network() == network
    };
    picture.links.iter().map(|link| &**link).find(matches)
}

/// Returns whether a stored link is in a picture, too.
pub(crate) fn is_live(picture: &LiveState, row: &LinkRow) -> bool {
    let key = row.key();
    picture.links.iter().any(|link| key_of(link) == key)
}

fn key_of(link: &LinkSnapshot) -> LinkKey {
    LinkKey { edge: link.edge, cloud: link.live.peer, network: link.live.network().clone() }
}

/// Returns the error for a link that is neither in a picture nor stored.
pub(crate) fn no_link(wanted: &str) -> WebError {
    WebError::NotFound(format!(
        "no link {wanted} has ever been told of here; a link is named EDGE~CLOUD, or EDGE~CLOUD~NETWORK where the network \
         is not zmq-tcp"
    ))
}

/// Link of a page: as it is now, or as it was when it was last reported.
#[derive(Clone, Debug)]
pub(crate) struct Subject<'a> {
    pub edge: String,
    pub cloud: String,
    pub key: LinkKey,
    /// `None` for a link that is stored and not in the live picture.
    pub live: Option<&'a LinkSnapshot>,
    /// The newest point's time, on the edge's wall clock.
    pub end: WallTime,
    /// `true` if the edge tells of it now.
    pub connected: bool,
    /// Last offset of a link that is stored and not in the live picture.
    told: Option<Offset>,
    /// Assumptions behind the bounds; `None` where both hosts read one clock, and where none were reported.
    pub assumptions: Option<DelayAssumptions>,
}

/// Returns the estimate and half the width of the bounds, seconds; `None` where sources exclude each other, or exchanges contradict each
/// other, because such an offset has no value.
pub(crate) fn known(offset: &Offset) -> Option<(f64, f64)> {
    let half = offset.bounds.width().seconds() / 2.0;
    (offset.verdict != Verdict::Inconsistent).then(|| (offset.estimate.seconds(), half))
}

/// Reason why there is no value.
pub(crate) const CONTRADICTION: &str = "what is known of the clocks contradicts itself";
/// Number of exchanges below which clocks are not related.
const LEAST_EXCHANGES: u64 = 3;

/// Returns whether an offset is stale because the link is young, or a clock was stepped a moment ago.
pub(crate) fn is_young(offset: &Offset) -> bool {
    offset.verdict == Verdict::Stale && offset.exchanges < LEAST_EXCHANGES
}

impl<'a> Subject<'a> {
    /// Returns a link of the picture.
    pub(crate) fn live(link: &'a LinkSnapshot) -> Self {
        Self {
            edge: link.edge_name.to_string(),
            cloud: link.live.peer_name.to_string(),
            key: key_of(link),
            end: link.history.last().map_or(link.live.now.at, |point| point.at),
            connected: link.connected,
            told: None,
            assumptions: (!link.live.same_clock).then(|| DelayAssumptions::from(&link.live.now)),
            live: Some(link),
        }
    }

    /// Returns a link that is only stored.
    pub(crate) fn past(row: &LinkRow) -> Self {
        Self {
            edge: row.edge_name.to_string(),
            cloud: row.cloud_name.to_string(),
            key: row.key(),
            live: None,
            end: row.last,
            connected: false,
            told: None,
            assumptions: None,
        }
    }

    /// Sets the assumptions of its newest stored window.
    pub(crate) fn assuming(self, assumptions: Option<DelayAssumptions>) -> Self {
        Self { assumptions, ..self }
    }

    /// Returns the clocks that are related.
    pub(crate) fn clocks(&self) -> RelatedClocks {
        self.assumptions.map_or(RelatedClocks::Wall, |assumptions| assumptions.clocks)
    }

    /// Sets the last offset of its course.
    pub(crate) fn remembering(self, course: &course::Course) -> Self {
        let told = course.points.iter().rev().find_map(|point| point.offset.clone());
        Self { told, ..self }
    }

    /// Returns `cam-3 → rack-a`; with the network where that is not `zmq-tcp`.
    pub(crate) fn route(&self) -> String {
        let Self { edge, cloud, key, .. } = self;
        if key.network.is_default() {
            format!("{edge} → {cloud}")
        } else {
            format!("{edge} → {cloud} over {}", key.network)
        }
    }

    /// Returns the link's name in addresses.
    pub(crate) fn name(&self) -> String {
        name(&self.edge, &self.cloud, &self.key.network)
    }

    /// Returns the address of its page.
    pub(crate) fn href(&self) -> String {
        href(&self.edge, &self.cloud, &self.key.network)
    }

    /// Returns whether both hosts read one clock.
    pub(crate) fn same_clock(&self) -> bool {
        self.live.is_some_and(|link| link.live.same_clock)
    }

    /// Returns the last ten minutes.
    pub(crate) fn history(&self) -> &'a [Arc<ClockPoint>] {
        self.live.map_or(&[], |link| link.history.as_slice())
    }

    /// Returns the current offset, or the one that the edge reported last.
    pub(crate) fn offset(&self) -> Option<&Offset> {
        let Some(link) = self.live else { return self.told.as_ref() };
        // An offset from before a step says nothing about the present.
        let counts = |point: &&Arc<ClockPoint>| !self.connected || point.window == link.live.now.window;
        let lately = if self.connected { 1 } else { link.history.len() };
        let mut before = link.history.iter().rev().take(lately).filter(counts);
        link.live.now.offset.as_ref().or_else(|| before.find_map(|point| point.offset.as_ref()))
    }

    /// Returns whether sources or exchanges contradict each other.
    pub(crate) fn contradicts(&self) -> bool {
        self.offset().is_some_and(|offset| offset.verdict == Verdict::Inconsistent)
    }

    /// Returns whether exchanges have finished, before a step or long ago though it may be.
    pub(crate) fn was_related(&self) -> bool {
        self.live.is_none_or(|link| {
            link.live.now.exchanges.taken > 0 || link.history.iter().any(|point| point.offset.is_some())
        })
    }

    /// Returns half the width of the offset's bounds, seconds; `None` where there are none.
    pub(crate) fn bound(&self) -> Option<f64> {
        if self.same_clock() {
            return Some(0.0);
        }
        known(self.offset()?).map(|(_, half)| half)
    }

    /// Returns the delays of data of the last ten seconds. Those that were judged before the clocks were known as they are now
    /// do not count: a link is not to be coloured by its first moments.
    pub(crate) fn delays(&self, way: NetworkDirection) -> Delays {
        let since = self.end - LATELY;
        let lately = self.history().iter().rev().take_while(|point| point.at > since);
        let mut settled: Vec<&ClockPoint> = lately.map(|point| &**point).collect();
        let before = settled.iter().position(|point| !is_settled(point) || point.window != settled[0].window);
        let begun = self.history().len() == settled.len();
        // In the second in which they came to be known some were judged before.
        let all = before.unwrap_or(settled.len() + usize::from(!begun));
        if all > 1 && !self.same_clock() {
            settled.truncate(all - 1);
        }
        Delays::of(way, settled)
    }

    /// Returns the verdict of the whole link: that of the offset. Where that is well, delays may still be too short for its
    /// bound.
    pub(crate) fn verdict(&self) -> Option<Verdict> {
        let clocks = match (self.same_clock(), self.offset()) {
            (true, _) => Verdict::Ok,
            (false, Some(offset)) => offset.verdict,
            (false, None) => return self.live.map(|_| Verdict::Unsynchronised),
        };
        let limited = [NetworkDirection::Up, NetworkDirection::Down]
            .into_iter()
            .any(|way| self.delays(way).verdict == Some(Verdict::Limited));
        Some(if clocks == Verdict::Ok && limited { Verdict::Limited } else { clocks })
    }

    /// Returns the names of the pipelines that use the link, with the addresses of their pages.
    pub(crate) fn pipelines(&self) -> Vec<(String, String)> {
        let used = self.live.into_iter().flat_map(|link| &link.live.pipelines);
        used.map(|name| (name.to_string(), super::place::pipeline_href(&self.edge, name.as_str()))).collect()
    }
}

/// Returns whether the clocks were known at the end of a second.
fn is_settled(point: &ClockPoint) -> bool {
    point.offset.as_ref().is_some_and(|offset| offset.verdict == Verdict::Ok)
}

#[cfg(test)]
mod tests;
