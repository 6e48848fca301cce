//! The current state of one host.
//!
//! A host is connected, has said goodbye, or is silent. An agent that stops cleanly sends a last live update and a
//! goodbye, so its pipelines have ended. The pipelines of a host that became silent without a goodbye are away: it is
//! unknown whether these pipelines still run.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{HostClock, HostDescription, LinkLive, LiveUpdate, NetworkName};

use super::event_account::EventAccount;
use super::limits;
use super::link::Link;
use super::metrics_history::MetricsHistory;
use super::pipeline::Pipeline;
use super::presence::Presence;
use super::{MAX_HOST_LINKS, MAX_HOST_PIPELINES};
use crate::live_state::{HostSnapshot, LinkSnapshot, PipelineSnapshot, RejectedBatches};
use peernet_store::StoredCounts;

/// State of one host with its pipelines and links.
#[derive(Debug)]
pub(super) struct Host {
    description: HostDescription,
    presence: Presence,
    clock: HostClock,
    metrics: MetricsHistory,
    events: EventAccount,
    /// Number of items of the host's messages that exceeded the limits and were discarded.
    discarded_items: u64,
    pipelines: BTreeMap<Slug, Pipeline>,
    /// Keyed by the cloud and the network.
    links: BTreeMap<(HostId, NetworkName), Link>,
    /// The latest snapshot; `None` if something changed since.
    snapshot: Option<Arc<HostSnapshot>>,
}

impl Host {
    /// Creates the state at the host's first hello.
    pub(super) fn new(mut description: HostDescription, process: u64, now: Stamp) -> Self {
        let mut discarded_items = 0;
        limits::limit_description(&mut description, &mut discarded_items);
        Self {
            description,
            presence: Presence::new(process, now),
            clock: HostClock::default(),
            metrics: MetricsHistory::new(now.mono),
            events: EventAccount::default(),
            discarded_items,
            pipelines: BTreeMap::new(),
            links: BTreeMap::new(),
            snapshot: None,
        }
    }

    /// Processes another hello. After the start of a new process the values of the previous process remain, so that
    /// counters do not drop to zero for a moment. The pipelines of the previous process are marked as away.
    pub(super) fn introduce(&mut self, mut description: HostDescription, process: u64, now: Stamp) {
        limits::limit_description(&mut description, &mut self.discarded_items);
        if self.description.name != description.name {
            self.pipelines.values_mut().for_each(Pipeline::invalidate_snapshot);
            self.links.values_mut().for_each(Link::invalidate_snapshot);
        }
        self.description = description;
        let is_same_process = self.presence.introduce(process, now);
        if !is_same_process {
            self.mark_silent();
        }
        self.snapshot = None;
    }

    /// Processes a goodbye. All pipelines in the host's latest update have ended, even if that update shows them as
    /// running. The host's other pipelines are away.
    pub(super) fn goodbye(&mut self) {
        let last_update = self.presence.sent_by_current_process();
        for pipeline in self.pipelines.values_mut() {
            // Only the pipelines of the last update ended cleanly. The other pipelines had disappeared before.
            if Some(pipeline.sent()) == last_update {
                pipeline.mark_finished();
            } else {
                pipeline.mark_away();
            }
        }
        self.presence.mark_left();
        self.snapshot = None;
    }

    /// Marks the host as silent, unless it has said goodbye, and its pipelines as away.
    fn mark_silent(&mut self) {
        self.presence.mark_silent();
        self.snapshot = None;
        self.pipelines.values_mut().for_each(Pipeline::mark_away);
    }

    /// Returns whether the host is connected.
    fn is_connected(&self) -> bool {
        self.presence.is_connected()
    }

    /// Applies a live update, within the limits.
    pub(super) fn update(&mut self, update: LiveUpdate, now: Stamp) {
        self.presence.update(update.sent, now);
        self.events.update(update.accounting, update.sent, now.mono);
        self.metrics.push(update.metrics, now);
        self.clock = update.clock;
        limits::limit_clock(&mut self.clock, &mut self.discarded_items);
        for live in update.pipelines {
            if let Some(pipeline) = self.pipelines.get_mut(&live.pipeline) {
                pipeline.update(live, update.sent, now, &mut self.discarded_items);
            } else if self.pipelines.len() < MAX_HOST_PIPELINES {
                let name = live.pipeline.clone();
                self.pipelines.insert(name, Pipeline::new(live, update.sent, now, &mut self.discarded_items));
            } else {
                self.discarded_items += 1;
            }
        }
        update.links.into_iter().for_each(|live| self.update_link(live, update.sent, now));
        self.snapshot = None;
    }

    /// Applies the state of one link in a live update.
    fn update_link(&mut self, live: LinkLive, sent: WallTime, now: Stamp) {
        let key = (live.peer, live.network().clone());
        if let Some(link) = self.links.get_mut(&key) {
            link.update(live, sent, now, &mut self.discarded_items);
        } else if self.links.len() < MAX_HOST_LINKS {
            self.links.insert(key, Link::new(live, sent, now, &mut self.discarded_items));
        } else {
            self.discarded_items += 1;
        }
    }

    /// Applies the database's counts. `newest` is the time of the host's newest stored event on the host's clock;
    /// `None` if it is unknown.
    pub(super) fn update_stored(&mut self, stored: StoredCounts, newest: Option<WallTime>) {
        self.events.update_stored(stored, newest);
        self.snapshot = None;
    }

    /// Returns whether the database holds events of the host.
    pub(super) fn has_stored_events(&self) -> bool {
        self.events.stored().events > 0
    }

    /// Returns the latest counts of the database.
    pub(super) fn stored(&self) -> StoredCounts {
        self.events.stored()
    }

    /// Counts a duplicate batch.
    pub(super) fn record_duplicate(&mut self) {
        self.events.add_duplicate();
        self.snapshot = None;
    }

    /// Counts a batch that arrived and was not stored. `count` increments the count of the reason:
    /// deferred or damaged.
    pub(super) fn record_rejected(&mut self, count: impl FnOnce(&mut RejectedBatches)) {
        self.events.add_rejected(count);
        self.snapshot = None;
    }

    /// Discards the snapshot of the pipeline that executes this run, because the run's number has changed.
    pub(super) fn refresh_run(&mut self, run: RunId) {
        let pipelines = self.pipelines.values_mut().filter(|pipeline| pipeline.run() == Some(run));
        pipelines.for_each(Pipeline::invalidate_snapshot);
    }

    /// Returns the current or last runs of the host's pipelines.
    pub(super) fn runs(&self) -> impl Iterator<Item = RunId> {
        self.pipelines.values().filter_map(Pipeline::run)
    }

    /// Applies the passing of time. Pipelines and links that were not reported for `timeout` are removed. Returns
    /// whether anything visible changed.
    pub(super) fn expire(&mut self, now: Stamp, timeout: Span) -> bool {
        let mut changed = false;
        if self.presence.is_overdue(now.mono) {
            self.mark_silent();
            changed = true;
        }
        let previous_counts = (self.pipelines.len(), self.links.len());
        self.pipelines.retain(|_, pipeline| now.mono - pipeline.last_seen() <= timeout);
        self.links.retain(|_, link| now.mono - link.last_seen() <= timeout);
        changed |= (self.pipelines.len(), self.links.len()) != previous_counts;
        for pipeline in self.pipelines.values_mut() {
            changed |= pipeline.expire(now);
        }
        changed
    }

    /// Returns the time of the host's last message.
    pub(super) fn last_seen(&self) -> MonoTime {
        self.presence.last_seen().mono
    }

    /// Returns the key by which the live state is sorted: first the name. Of several hosts with one name, a connected
    /// host is first, otherwise the host that sent the last message.
    pub(super) fn sort_key(&self) -> (Slug, Reverse<(bool, MonoTime)>, HostId) {
        let HostDescription { id, name, .. } = &self.description;
        (name.clone(), Reverse((self.is_connected(), self.last_seen())), *id)
    }

    /// Returns the host's snapshot.
    pub(super) fn snapshot(&mut self) -> Arc<HostSnapshot> {
        if let Some(cached) = &self.snapshot {
            return Arc::clone(cached);
        }
        let snapshot = Arc::new(HostSnapshot {
            id: self.description.id,
            description: self.description.clone(),
            connected: self.is_connected(),
            has_left: self.presence.has_left() && self.events.accounting().waiting == 0,
            last_seen: self.presence.last_seen().wall,
            clock_ahead: self.presence.clock_ahead(),
            behind: self.events.storage_lag(self.presence.sent()),
            // The rate is not valid while the host is disconnected, because nothing is stored then.
            catching_up: self.events.lag_estimator().estimate().filter(|_| self.is_connected()),
            clock: self.clock.clone(),
            metrics: self.metrics.current().clone(),
            history: self.metrics.points(),
            accounting: self.events.accounting().clone(),
            stored: self.events.stored(),
            rejected_batches: self.events.rejected_batches(),
            newest_stored: self.events.newest_stored(),
            live_left_out: self.discarded_items,
        });
        self.snapshot = Some(Arc::clone(&snapshot));
        snapshot
    }

    /// Returns the snapshots of the host's pipelines, sorted by name. `number` returns the store's number of a run.
    pub(super) fn pipelines(
        &mut self,
        number: impl Fn(RunId) -> Option<i64> + Copy,
        now: Stamp,
    ) -> impl Iterator<Item = Arc<PipelineSnapshot>> {
        let Self { description, pipelines, .. } = self;
        pipelines.iter_mut().map(move |(name, pipeline)| {
            pipeline.snapshot((description.id, &description.name, name), number, now)
        })
    }

    /// Returns the snapshots of the host's links, sorted by the cloud's name and the network. Of several links with one
    /// name, the link that was reported last is first.
    pub(super) fn links(&mut self) -> Vec<Arc<LinkSnapshot>> {
        // A link is connected only if the edge's latest message contained it.
        let last_message = self.is_connected().then_some(self.presence.last_seen().mono);
        let mut links: Vec<(&(HostId, NetworkName), &mut Link)> = self.links.iter_mut().collect();
        links.sort_by_cached_key(|((cloud, network), link)| {
            (link.cloud().clone(), network.clone(), Reverse(link.last_seen()), *cloud)
        });
        let snapshots = links
            .into_iter()
            .map(|(_, link)| link.snapshot(self.description.id, &self.description.name, last_message));
        snapshots.collect()
    }
}
