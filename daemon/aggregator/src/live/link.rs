//! What is known of one link, now: an edge and a cloud over one network.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, Slug};
use peernet_stream::{ClockSample, LinkLive};

use super::bounds;
use crate::picture::LinkPicture;
use peernet_store::ClockPoint;

/// Seconds of the history.
const HISTORY_S: i64 = 600;
/// A report's parts may be made so long after it was stamped.
const LATER: Span = Span::from_millis(100);

/// One link: as last reported, and its last seconds on the edge's own wall clock, whatever that shows.
#[derive(Debug)]
pub(super) struct Link {
    live: LinkLive,
    seen: Stamp,
    history: BTreeMap<i64, Arc<ClockPoint>>,
    /// As last drawn; `None` when something changed since.
    picture: Option<Arc<LinkPicture>>,
}

impl Link {
    /// A link at its first report.
    pub(super) fn new(live: LinkLive, sent: WallTime, now: Stamp, left_out: &mut u64) -> Self {
        let mut link = Self { live: live.clone(), seen: now, history: BTreeMap::new(), picture: None };
        link.update(live, sent, now, left_out);
        link
    }

    /// Takes over a report, within the limits. A second that was known is replaced: each report of it is complete up
    /// to then.
    pub(super) fn update(&mut self, mut live: LinkLive, sent: WallTime, now: Stamp, left_out: &mut u64) {
        bounds::link(&mut live, left_out);
        // The second under way. What is known of later ones was said before the edge's clock was set back.
        let newest = (sent + LATER).unix_seconds();
        drop(self.history.split_off(&newest.saturating_add(1)));
        let at = second(live.now.at);
        if at <= newest && at > newest.saturating_sub(HISTORY_S) {
            self.history.insert(at, Arc::new(point(&live.now)));
        } else {
            *left_out += 1;
        }
        if let Some((last, _)) = self.history.last_key_value() {
            self.history = self.history.split_off(&(last.saturating_sub(HISTORY_S) + 1));
        }
        (self.live, self.seen, self.picture) = (live, now, None);
    }

    /// When it was last reported.
    pub(super) fn seen(&self) -> MonoTime {
        self.seen.mono
    }

    /// The cloud's name, for the order of the picture.
    pub(super) fn cloud(&self) -> &Slug {
        &self.live.peer_name
    }

    /// Something beside the reports changed what is drawn.
    pub(super) fn redraw(&mut self) {
        self.picture = None;
    }

    /// The link as it is shown; `last` is when its edge was last heard of, if that is connected.
    pub(super) fn picture(&mut self, edge: HostId, name: &Slug, last: Option<MonoTime>) -> Arc<LinkPicture> {
        // An edge that is there and no longer names the link has nothing to do with the cloud any more.
        let connected = last == Some(self.seen.mono);
        if let Some(drawn) = &self.picture
            && drawn.connected == connected
        {
            return Arc::clone(drawn);
        }
        let picture = Arc::new(LinkPicture {
            edge,
            edge_name: name.clone(),
            connected,
            last_seen: self.seen.wall,
            live: self.live.clone(),
            history: self.history.values().cloned().collect(),
        });
        self.picture = Some(Arc::clone(&picture));
        picture
    }
}

/// The second that ends at `at` or holds it, by its begin.
fn second(at: WallTime) -> i64 {
    (at - Span::from_nanos(1)).unix_seconds()
}

fn point(sample: &ClockSample) -> ClockPoint {
    ClockPoint {
        at: sample.at,
        window: sample.window,
        offset: sample.offset.clone(),
        probes: sample.probes,
        round_trip: sample.round_trip,
        up: sample.up,
        down: sample.down,
        clocks: sample.clocks(),
        proven_skew_ppm: sample.basis.and_then(|basis| basis.proven_skew_ppm),
        grown_window: sample.basis.and_then(|basis| basis.grown_window),
    }
}
