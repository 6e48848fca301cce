//! What is known of one host, now.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{HostClock, HostDescription, LinkLive, LiveUpdate, NetworkName};

use super::bounds;
use super::event_account::EventAccount;
use super::link::Link;
use super::metrics_history::MetricsHistory;
use super::pipeline::Pipeline;
use super::presence::Presence;
use super::{MOST_LINKS, MOST_PIPELINES};
use crate::picture::{Arrivals, HostPicture, LinkPicture, PipelinePicture};
use peernet_store::Stored;

/// One host, its pipelines and its links.
#[derive(Debug)]
pub(super) struct Host {
    description: HostDescription,
    presence: Presence,
    clock: HostClock,
    metrics: MetricsHistory,
    events: EventAccount,
    /// Values that were left out of what it told, because they were beyond the limits.
    left_out: u64,
    pipelines: BTreeMap<Slug, Pipeline>,
    /// By the cloud and the network.
    links: BTreeMap<(HostId, NetworkName), Link>,
    picture: Option<Arc<HostPicture>>,
}

impl Host {
    /// A host that just introduced itself.
    pub(super) fn new(mut description: HostDescription, process: u64, now: Stamp) -> Self {
        let mut left_out = 0;
        bounds::description(&mut description, &mut left_out);
        Self {
            description,
            presence: Presence::new(process, now),
            clock: HostClock::default(),
            metrics: MetricsHistory::new(now.mono),
            events: EventAccount::default(),
            left_out,
            pipelines: BTreeMap::new(),
            links: BTreeMap::new(),
            picture: None,
        }
    }

    /// It introduced itself again. What another process of it told stays, as that of a host that is away: counters
    /// must not begin anew for a moment.
    pub(super) fn introduce(&mut self, mut description: HostDescription, process: u64, now: Stamp) {
        bounds::description(&mut description, &mut self.left_out);
        if self.description.name != description.name {
            self.pipelines.values_mut().for_each(Pipeline::redraw);
            self.links.values_mut().for_each(Link::redraw);
        }
        self.description = description;
        if !self.presence.introduce(process, now) {
            self.lose();
        }
        self.picture = None;
    }

    /// It takes its leave: what it told of last has ended, whatever it was told to be at.
    pub(super) fn goodbye(&mut self) {
        let last = self.presence.sent_by_current();
        for pipeline in self.pipelines.values_mut() {
            if Some(pipeline.sent()) == last {
                pipeline.end();
            } else {
                pipeline.away();
            }
        }
        self.presence.leave();
        self.picture = None;
    }

    /// It is gone without a word, unless it had left before.
    fn lose(&mut self) {
        self.presence.lose();
        self.picture = None;
        self.pipelines.values_mut().for_each(Pipeline::away);
    }

    fn is_connected(&self) -> bool {
        self.presence.is_connected()
    }

    /// Takes over an update, within the limits.
    pub(super) fn update(&mut self, update: LiveUpdate, now: Stamp) {
        self.presence.update(update.sent, now);
        self.events.update(update.accounting, update.sent, now.mono);
        self.metrics.push(update.metrics, now);
        self.clock = update.clock;
        bounds::clock(&mut self.clock, &mut self.left_out);
        for live in update.pipelines {
            if let Some(pipeline) = self.pipelines.get_mut(&live.pipeline) {
                pipeline.update(live, update.sent, now, &mut self.left_out);
            } else if self.pipelines.len() < MOST_PIPELINES {
                let name = live.pipeline.clone();
                self.pipelines.insert(name, Pipeline::new(live, update.sent, now, &mut self.left_out));
            } else {
                self.left_out += 1;
            }
        }
        update.links.into_iter().for_each(|live| self.link(live, update.sent, now));
        self.picture = None;
    }

    fn link(&mut self, live: LinkLive, sent: WallTime, now: Stamp) {
        let key = (live.peer, live.network().clone());
        if let Some(link) = self.links.get_mut(&key) {
            link.update(live, sent, now, &mut self.left_out);
        } else if self.links.len() < MOST_LINKS {
            self.links.insert(key, Link::new(live, sent, now, &mut self.left_out));
        } else {
            self.left_out += 1;
        }
    }

    /// What the database now holds of it.
    pub(super) fn store(&mut self, stored: Stored, newest: Option<WallTime>) {
        self.events.store(stored, newest);
        self.picture = None;
    }

    /// Whether the database holds events of it.
    pub(super) fn has_stored(&self) -> bool {
        self.events.stored().events > 0
    }

    /// What the database was last said to hold of it.
    pub(super) fn stored(&self) -> Stored {
        self.events.stored()
    }

    /// A batch of it came again.
    pub(super) fn duplicate(&mut self) {
        self.events.add_duplicate();
        self.picture = None;
    }

    /// A batch of it came and was not taken.
    pub(super) fn arrived(&mut self, count: impl FnOnce(&mut Arrivals)) {
        self.events.add_arrival(count);
        self.picture = None;
    }

    /// The store gave a run its number.
    pub(super) fn number(&mut self, run: RunId) {
        let of_run = self.pipelines.values_mut().filter(|pipeline| pipeline.run() == Some(run));
        of_run.for_each(Pipeline::redraw);
    }

    /// The current or last runs of its pipelines.
    pub(super) fn runs(&self) -> impl Iterator<Item = RunId> {
        self.pipelines.values().filter_map(Pipeline::run)
    }

    /// Lets time pass; whether that changed anything to be seen.
    pub(super) fn age(&mut self, now: Stamp, forget: Span) -> bool {
        let mut changed = false;
        if self.presence.is_overdue(now.mono) {
            self.lose();
            changed = true;
        }
        let before = (self.pipelines.len(), self.links.len());
        self.pipelines.retain(|_, pipeline| now.mono - pipeline.seen() <= forget);
        self.links.retain(|_, link| now.mono - link.seen() <= forget);
        changed |= (self.pipelines.len(), self.links.len()) != before;
        for pipeline in self.pipelines.values_mut() {
            changed |= pipeline.age(now);
        }
        changed
    }

    /// When it was last heard of.
    pub(super) fn seen(&self) -> MonoTime {
        self.presence.seen().mono
    }

    /// Its name, for the order of the picture.
    pub(super) fn name(&self) -> &Slug {
        &self.description.name
    }

    /// The host as it is shown.
    pub(super) fn picture(&mut self) -> Arc<HostPicture> {
        if let Some(drawn) = &self.picture {
            return Arc::clone(drawn);
        }
        let picture = Arc::new(HostPicture {
            id: self.description.id,
            description: self.description.clone(),
            connected: self.is_connected(),
            left: self.presence.has_left() && self.events.accounting().waiting == 0,
            last_seen: self.presence.seen().wall,
            clock_ahead: self.presence.clock_ahead(),
            behind: self.events.behind(self.presence.sent()),
            // A host that is away stores nothing, however fast it did.
            catching_up: self.events.lag().catching_up().filter(|_| self.is_connected()),
            clock: self.clock.clone(),
            metrics: self.metrics.current().clone(),
            history: self.metrics.points(),
            accounting: self.events.accounting().clone(),
            stored: self.events.stored(),
            arrivals: self.events.arrivals(),
            newest_stored: self.events.newest_stored(),
            live_left_out: self.left_out,
        });
        self.picture = Some(Arc::clone(&picture));
        picture
    }

    /// Its pipelines as they are shown, by name.
    pub(super) fn pipelines(
        &mut self,
        number: impl Fn(RunId) -> Option<i64> + Copy,
        now: Stamp,
    ) -> impl Iterator<Item = Arc<PipelinePicture>> {
        let Self { description, pipelines, .. } = self;
        pipelines.iter_mut().map(move |(name, pipeline)| {
            pipeline.picture((description.id, &description.name, name), number, now)
        })
    }

    /// Its links as they are shown, by the cloud's name and the network.
    pub(super) fn links(&mut self) -> Vec<Arc<LinkPicture>> {
        let last = self.is_connected().then_some(self.presence.seen().mono);
        let mut links: Vec<(&(HostId, NetworkName), &mut Link)> = self.links.iter_mut().collect();
        links.sort_by(|(a, x), (b, y)| (x.cloud(), a).cmp(&(y.cloud(), b)));
        let drawn = links
            .into_iter()
            .map(|(_, link)| link.picture(self.description.id, &self.description.name, last));
        drawn.collect()
    }
}
