//! The current state of one link: an edge and a cloud over one network.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, Slug};
use peernet_stream::{ClockSample, LinkLive};

use super::limits;
use crate::live_state::LinkSnapshot;
use peernet_store::ClockPoint;

/// Length of the history, seconds.
const HISTORY_S: i64 = 600;
/// Longest time by which the state of a link may be newer than the stamp of its update. An update is stamped before the
/// states in the update are created.
const MAX_STATE_SKEW: Span = Span::from_millis(100);

/// The latest state of one link, and a history by seconds of the edge's wall clock, which may be wrong.
#[derive(Debug)]
pub(super) struct Link {
    live: LinkLive,
    last_seen: Stamp,
    history: BTreeMap<i64, Arc<ClockPoint>>,
    /// The latest snapshot; `None` if something changed since.
    snapshot: Option<Arc<LinkSnapshot>>,
}

impl Link {
    /// Creates the link from its first state.
    pub(super) fn new(live: LinkLive, sent: WallTime, now: Stamp, discarded_items: &mut u64) -> Self {
        let mut link = Self { live: live.clone(), last_seen: now, history: BTreeMap::new(), snapshot: None };
        link.update(live, sent, now, discarded_items);
        link
    }

    /// Applies a newer state, within the limits. The point of a second replaces an earlier point of the same second,
    /// because each state covers its second from the start.
    pub(super) fn update(
        &mut self,
        mut live: LinkLive,
        sent: WallTime,
        now: Stamp,
        discarded_items: &mut u64,
    ) {
        limits::limit_link(&mut live, discarded_items);
        // Seconds of the history that are later than this update are dropped: they were reported before the edge's
        // clock was set back.
        let newest_second = (sent + MAX_STATE_SKEW).unix_seconds();
        drop(self.history.split_off(&newest_second.saturating_add(1)));
        let second = second_of(live.latest_sample.at);
        if second <= newest_second && second > newest_second.saturating_sub(HISTORY_S) {
            self.history.insert(second, Arc::new(point(&live.latest_sample)));
        } else {
            *discarded_items += 1;
        }
        if let Some((newest, _)) = self.history.last_key_value() {
            self.history = self.history.split_off(&(newest.saturating_sub(HISTORY_S) + 1));
        }
        (self.live, self.last_seen, self.snapshot) = (live, now, None);
    }

    /// Returns the time of the latest update that contained the link.
    pub(super) fn last_seen(&self) -> MonoTime {
        self.last_seen.mono
    }

    /// Returns the cloud's name, by which the live state is sorted.
    pub(super) fn cloud(&self) -> &Slug {
        &self.live.peer_name
    }

    /// Discards the snapshot after a change outside the updates.
    pub(super) fn invalidate_snapshot(&mut self) {
        self.snapshot = None;
    }

    /// Returns the link's snapshot. `last_message` is the time of the edge's last message if the edge is connected.
    pub(super) fn snapshot(
        &mut self,
        edge: HostId,
        edge_name: &Slug,
        last_message: Option<MonoTime>,
    ) -> Arc<LinkSnapshot> {
        // A connected edge whose latest update does not contain the link does not use the cloud any more.
        let connected = last_message == Some(self.last_seen.mono);
        if let Some(cached) = &self.snapshot
            && cached.connected == connected
        {
            return Arc::clone(cached);
        }
        let snapshot = Arc::new(LinkSnapshot {
            edge,
            edge_name: edge_name.clone(),
            connected,
            last_seen: self.last_seen.wall,
            live: self.live.clone(),
            history: self.history.values().cloned().collect(),
        });
        self.snapshot = Some(Arc::clone(&snapshot));
        snapshot
    }
}

/// Returns the start of the second that a state at `at` covers, in Unix seconds. A state at the end of a second covers
/// that second.
fn second_of(at: WallTime) -> i64 {
    (at - Span::from_nanos(1)).unix_seconds()
}

/// Returns the history's point of a sample.
fn point(sample: &ClockSample) -> ClockPoint {
    ClockPoint {
        at: sample.at,
        relation_period: sample.relation_period,
        offset: sample.offset.clone(),
        probes: sample.probes,
        round_trip: sample.round_trip,
        up: sample.up,
        down: sample.down,
        clocks: sample.clocks(),
        proven_skew_ppm: sample.basis.and_then(|basis| basis.proven_skew_ppm),
        oldest_exchange_age: sample.basis.and_then(|basis| basis.oldest_exchange_age),
    }
}
