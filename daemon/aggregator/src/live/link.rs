//! What is known of one link, now.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::stream::{ClockSample, HostClock, LinkLive, Probing};
use peernet_logger::{HostId, Slug};

use crate::picture::{ClockPoint, LinkPicture};
use crate::plausible;

/// Seconds of the history.
const HISTORY_S: i64 = 600;
/// A report's parts may be made so long after it was stamped.
const LATER: Span = Span::from_millis(100);
/// Kinds of network, pipelines and steps of a rehearsal that are shown of one link.
const MOST_LISTED: usize = 32;
/// Bytes of a text.
const MOST_TEXT: usize = 512;

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
        bound(&mut live, left_out);
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
    }
}

/// Cuts a report to what is shown.
fn bound(live: &mut LinkLive, left_out: &mut u64) {
    list(&mut live.networks, left_out);
    live.networks.iter_mut().for_each(text);
    list(&mut live.pipelines, left_out);
    match &mut live.probing {
        Probing::On { address, stamps, .. } => [address, stamps].into_iter().for_each(text),
        Probing::Unanswered { address, reason } => [address].into_iter().chain(reason).for_each(text),
        Probing::Off(reason) => text(reason),
    }
    for clock in [&mut live.edge, &mut live.cloud].into_iter().flatten() {
        bound_clock(clock, left_out);
    }
    let now = &mut live.now;
    let offset = now.offset.as_ref().and_then(plausible::offset);
    let (up, down) = (now.up.map(plausible::delays), now.down.map(plausible::delays));
    // Not-a-number is unequal to itself: taken out and counted as well.
    *left_out += u64::from((&offset, up, down) != (&now.offset, now.up, now.down));
    (now.offset, now.up, now.down) = (offset, up, down);
}

/// Cuts what a host says of its clock to what is shown.
pub(super) fn bound_clock(clock: &mut HostClock, left_out: &mut u64) {
    text(&mut clock.text);
    if let Some(rehearsal) = &mut clock.rehearsal {
        list(&mut rehearsal.steps, left_out);
    }
}

fn list<T>(items: &mut Vec<T>, left_out: &mut u64) {
    *left_out += items.len().saturating_sub(MOST_LISTED) as u64;
    items.truncate(MOST_LISTED);
    items.shrink_to_fit();
}

fn text(text: &mut String) {
    text.truncate(text.floor_char_boundary(MOST_TEXT));
    text.shrink_to_fit();
}
