//! View of one link: an edge and a cloud over one network.

pub(crate) mod basis;
pub(crate) mod chart;
pub(crate) mod connections;
pub(crate) mod delays;
pub(crate) mod finding;
pub(crate) mod list;
mod offset;
pub(crate) mod origin;
pub(crate) mod panels;
pub(crate) mod stats;
pub(crate) mod table;
pub(crate) mod time_series;
pub(crate) mod tracks;
pub(crate) mod traffic;

use std::sync::Arc;

use peernet_aggregator::{LinkSnapshot, LiveState};
use peernet_analysis::offset_trend::estimate_and_max_error;
use peernet_clock::{Direction, MIN_EXCHANGES_FOR_FRESHNESS, Offset, RelatedClocks, Span, Verdict, WallTime};
use peernet_store::{ClockPoint, DelayAssumptions, LinkKey, LinkRow};
use peernet_stream::{NetworkName, Placement, PlacementKind};

use crate::error::WebError;
use delays::Delays;

/// Time span of the delays and rates that count as current.
const RECENT_SPAN: Span = Span::from_seconds(10);

/// Separator between edge, cloud and network in a link's name. None of these three names can contain the separator.
pub(crate) const NAME_SEPARATOR: char = '~';

/// Returns the name of a link in addresses: `EDGE~CLOUD` if the network is `zmq-tcp`, as in earlier releases, otherwise
/// `EDGE~CLOUD~NETWORK`.
pub(crate) fn name(edge: &str, cloud: &str, network: &NetworkName) -> String {
    if network.is_default() {
        format!("{edge}{NAME_SEPARATOR}{cloud}")
    } else {
        format!("{edge}{NAME_SEPARATOR}{cloud}{NAME_SEPARATOR}{network}")
    }
}

/// Returns the canonical form of a link's name, without the network `zmq-tcp`.
pub(crate) fn canonical(link_name: String) -> String {
    match split_name(&link_name) {
        Some((edge, cloud, network)) => name(edge, cloud, &network),
        None => link_name,
    }
}

/// Splits a link's name into edge, cloud and network.
fn split_name(link_name: &str) -> Option<(&str, &str, NetworkName)> {
    let (edge, rest) = link_name.split_once(NAME_SEPARATOR)?;
    match rest.split_once(NAME_SEPARATOR) {
        Some((cloud, network)) => Some((edge, cloud, network.parse().ok()?)),
        None => Some((edge, rest, NetworkName::default())),
    }
}

/// Returns the address of a link's page.
pub(crate) fn href(edge: &str, cloud: &str, network: &NetworkName) -> String {
    format!("/links/{}", name(edge, cloud, network))
}

/// Returns the address of the page of the link that a placement uses; `None` if the link is not in the live state.
pub(crate) fn href_of_placement(snapshot: &LiveState, edge: &str, placement: &Placement) -> Option<String> {
    let cloud = placement.peer.as_ref().filter(|_| placement.kind == PlacementKind::Remote)?.as_str();
    let network = placement.network.as_ref().map(|network| network.parse::<NetworkName>());
    let network = network.transpose().ok()?;
    let network = network.unwrap_or_default();
    find(snapshot, &name(edge, cloud, &network)).map(|_| href(edge, cloud, &network))
}

/// Returns the link with a name from the live state.
pub(crate) fn find<'a>(snapshot: &'a LiveState, link_name: &str) -> Option<&'a LinkSnapshot> {
    let (edge, cloud, network) = split_name(link_name)?;
    let matches = |link: &&LinkSnapshot| {
        link.edge_name.as_str() == edge
            && link.live.peer_name.as_str() == cloud
            && *link.live.network() == network
    };
    snapshot.links.iter().map(|link| &**link).find(matches)
}

/// Returns whether a stored link is in the live state, too.
pub(crate) fn is_live(snapshot: &LiveState, row: &LinkRow) -> bool {
    let key = row.key();
    snapshot.links.iter().any(|link| link_key(link) == key)
}

fn link_key(link: &LinkSnapshot) -> LinkKey {
    LinkKey { edge: link.edge, cloud: link.live.peer, network: link.live.network().clone() }
}

/// Returns the error for a link that is neither in the live state nor stored.
pub(crate) fn no_link(link_name: &str) -> WebError {
    WebError::NotFound(format!(
        "no link {link_name} has ever been reported to this aggregator; a link is named EDGE~CLOUD, or EDGE~CLOUD~NETWORK where the network \
         is not {}",
        NetworkName::default()
    ))
}

/// The link of a page: its live state, or its last stored state.
#[derive(Clone, Debug)]
pub(crate) struct Subject<'a> {
    pub edge: String,
    pub cloud: String,
    pub key: LinkKey,
    /// `None` for a link that is stored and not in the live state.
    pub live: Option<&'a LinkSnapshot>,
    /// Time of the newest point, on the edge's wall clock.
    pub end: WallTime,
    /// `true` if the edge reports the link now.
    pub connected: bool,
    /// Last offset of a link that is stored and not in the live state.
    last_offset: Option<Offset>,
    /// Assumptions on which the bounds depend; `None` if both hosts read one clock, or no assumptions were reported.
    pub assumptions: Option<DelayAssumptions>,
}

/// Text for an offset without a value, because its sources or exchanges contradict each other.
pub(crate) const CONTRADICTION: &str = "what is known of the clocks contradicts itself";

/// Returns whether an offset is stale because the link is young, or a clock was stepped a moment ago.
pub(crate) fn is_young(offset: &Offset) -> bool {
    offset.verdict == Verdict::Stale && offset.exchanges < MIN_EXCHANGES_FOR_FRESHNESS
}

impl<'a> Subject<'a> {
    /// Creates the subject of a link in the live state.
    pub(crate) fn live(link: &'a LinkSnapshot) -> Self {
        Self {
            edge: link.edge_name.to_string(),
            cloud: link.live.peer_name.to_string(),
            key: link_key(link),
            end: link.history.last().map_or(link.live.latest_sample.at, |point| point.at),
            connected: link.connected,
            last_offset: None,
            assumptions: (!link.live.same_clock).then(|| DelayAssumptions::from(&link.live.latest_sample)),
            live: Some(link),
        }
    }

    /// Creates the subject of a link that is stored and not in the live state.
    pub(crate) fn past(row: &LinkRow) -> Self {
        Self {
            edge: row.edge_name.to_string(),
            cloud: row.cloud_name.to_string(),
            key: row.key(),
            live: None,
            end: row.last,
            connected: false,
            last_offset: None,
            assumptions: None,
        }
    }

    /// Sets the assumptions. A link that is not in the live state has the assumptions of its newest stored relation
    /// period.
    pub(crate) fn with_assumptions(self, assumptions: Option<DelayAssumptions>) -> Self {
        Self { assumptions, ..self }
    }

    /// Returns which clocks have the shown offset: the clocks of the assumptions, or the wall clocks without
    /// assumptions.
    pub(crate) fn clocks(&self) -> RelatedClocks {
        self.assumptions.map_or(RelatedClocks::Wall, |assumptions| assumptions.clocks)
    }

    /// Sets the last offset from the stored points.
    pub(crate) fn with_last_offset(self, time_series: &time_series::LinkTimeSeries) -> Self {
        let last_offset = time_series.points.iter().rev().find_map(|point| point.offset.clone());
        Self { last_offset, ..self }
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

    /// Returns the address of the link's page.
    pub(crate) fn href(&self) -> String {
        href(&self.edge, &self.cloud, &self.key.network)
    }

    /// Returns whether both hosts read one clock.
    pub(crate) fn same_clock(&self) -> bool {
        self.live.is_some_and(|link| link.live.same_clock)
    }

    /// Returns the points of the last ten minutes, oldest first; empty for a link that is not in the live state.
    pub(crate) fn history(&self) -> &'a [Arc<ClockPoint>] {
        self.live.map_or(&[], |link| link.history.as_slice())
    }

    /// Returns the current offset, or else the last offset that the edge reported.
    pub(crate) fn offset(&self) -> Option<&Offset> {
        let Some(link) = self.live else { return self.last_offset.as_ref() };
        // If the edge is connected, an older offset says nothing about the present. Only the newest point may stand in
        // for a missing offset, and only if no clock was stepped since then: a clock step begins a new relation
        // period.
        let is_valid = |point: &&Arc<ClockPoint>| {
            !self.connected || point.relation_period == link.live.latest_sample.relation_period
        };
        let recent = if self.connected { 1 } else { link.history.len() };
        let mut candidates = link.history.iter().rev().take(recent).filter(is_valid);
        link.live.latest_sample.offset.as_ref().or_else(|| candidates.find_map(|point| point.offset.as_ref()))
    }

    /// Returns whether sources or exchanges contradict each other.
    pub(crate) fn contradicts(&self) -> bool {
        self.offset().is_some_and(|offset| !offset.is_consistent())
    }

    /// Returns whether any exchange ever related the two clocks, even if a clock was stepped since then. `None` for a
    /// link that is not in the live state, because its counts of exchanges are not known.
    pub(crate) fn was_related(&self) -> Option<bool> {
        self.live.map(|link| {
            link.live.latest_sample.exchanges.accepted > 0
                || link.history.iter().any(|point| point.offset.is_some())
        })
    }

    /// Returns the largest error of the offset's estimate, seconds; `None` without bounds.
    pub(crate) fn bound(&self) -> Option<f64> {
        if self.same_clock() {
            return Some(0.0);
        }
        estimate_and_max_error(self.offset()?).map(|(_, max_error)| max_error)
    }

    /// Returns the drift of the cloud's clock against the edge's clock, ppm.
    ///
    /// # Errors
    /// The reason why the drift is not known.
    pub(crate) fn drift(&self) -> Result<f64, &'static str> {
        // Two clocks need more exchanges for a drift than for an offset.
        let reason = if self.contradicts() { CONTRADICTION } else { "too few exchanges yet" };
        self.offset().and_then(Offset::drift_ppm).ok_or(reason)
    }

    /// Returns the delays of messages in the last ten seconds. Delays from before the current clock relation was
    /// established are excluded, because the verdict of a link must not depend on the first seconds of the link.
    pub(crate) fn delays(&self, direction: Direction) -> Delays {
        let since = self.end - RECENT_SPAN;
        let recent = self.history().iter().rev().take_while(|point| point.at > since);
        let mut newest_first: Vec<&ClockPoint> = recent.map(|point| &**point).collect();
        let first_unsettled = newest_first
            .iter()
            .position(|point| !is_settled(point) || point.relation_period != newest_first[0].relation_period);
        let is_whole_history = self.history().len() == newest_first.len();
        // In the second in which the relation was established, some delays are older than the relation, so the whole
        // second is excluded. If all recent points are settled and there are older points, the relation was established
        // before the recent points, and no recent point is excluded.
        let settled_count = first_unsettled.unwrap_or(newest_first.len() + usize::from(!is_whole_history));
        // If at most the newest point is settled, no point would remain, so no point is excluded.
        if settled_count > 1 && !self.same_clock() {
            newest_first.truncate(settled_count - 1);
        }
        Delays::of(direction, newest_first)
    }

    /// Returns the verdict of the whole link: the worst of the verdicts of the offset and of both directions' delays.
    /// `Ok` if both hosts read one clock; `None` without an offset for a link that is not in the live state.
    pub(crate) fn verdict(&self) -> Option<Verdict> {
        if self.same_clock() {
            return Some(Verdict::Ok);
        }
        let without_offset = self.live.map(|_| Verdict::Unsynchronised);
        let of_offset = self.offset().map(|offset| offset.verdict).or(without_offset);
        let of_delays = Direction::ALL.map(|direction| self.delays(direction).verdict);
        Verdict::worst(of_delays.into_iter().flatten().chain(of_offset))
    }

    /// Returns the names of the pipelines that use the link, with the addresses of their pages.
    pub(crate) fn pipelines(&self) -> Vec<(String, String)> {
        let used = self.live.into_iter().flat_map(|link| &link.live.pipelines);
        used.map(|name| (name.to_string(), super::place::pipeline_href(&self.edge, name.as_str()))).collect()
    }
}

/// Returns whether the relation of the two clocks was established at the time of a point, which is the end of its
/// second.
fn is_settled(point: &ClockPoint) -> bool {
    point.offset.as_ref().is_some_and(|offset| offset.verdict == Verdict::Ok)
}

#[cfg(test)]
mod tests;
