//! The live state: the current state of all agents, from the live lane alone, so that it stays current regardless of
//! how many batches wait to be stored. Free of I/O; [`task`] owns the [`LiveTracker`] and publishes its snapshots.
//!
//! Memory is bounded whatever agents send: there are limits for the number of hosts, of pipelines and links per host,
//! and of node names in the report of one second of a pipeline. Values beyond a limit are discarded and counted.

mod event_account;
mod host;
mod lag_estimator;
pub(crate) mod limits;
mod link;
mod metrics_history;
mod percentiles;
mod pipeline;
mod presence;
mod second_statistics;
pub(crate) mod task;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::sync::Arc;

use peernet_clock::{Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{HostDescription, LiveUpdate};

use self::host::Host;
use crate::live_state::{LiveState, RefusedHost, Totals};
use peernet_store::StoredCounts;

/// Maximum number of hosts in the live state. For a further host, the host that was silent longest is removed.
const MAX_HOSTS: usize = 4_096;
/// Silence after which a host without stored events is removed from the live state.
const UNSTORED_HOST_TIMEOUT: Span = Span::from_seconds(600);
/// Maximum number of pipelines per host.
const MAX_HOST_PIPELINES: usize = peernet_stream::limits::MAX_PIPELINES;
/// Maximum number of links per host.
const MAX_HOST_LINKS: usize = 64;
/// Maximum number of node names in the report of one second of a pipeline, and in a window.
const MAX_NAMES: usize = 128;
/// Maximum number of refused hosts in the live state.
const MAX_REFUSED: usize = 32;
/// Time for which a refused host is shown.
const REFUSAL_SHOWN_FOR: Span = Span::from_seconds(600);
/// Maximum number of hosts outside the live state whose stored counts are kept for the totals.
// This is the largest permitted value of `max_hosts`, so the totals usually include all hosts in the database.
const MAX_REMEMBERED_HOSTS: usize = 65_536;
/// Maximum number of run numbers that are kept.
const MAX_RUN_NUMBERS: usize = 10_000;

/// An event that changes the live state.
#[derive(Debug)]
pub(crate) enum LiveEvent {
    /// A host's hello was accepted. The second field is the random number that the host's process drew at its start.
    Hello(Box<HostDescription>, u64),
    /// A live update.
    Update(Box<LiveUpdate>),
    /// A host's goodbye.
    Goodbye(HostId),
    /// A host was refused.
    Refused(RefusedHost),
    /// The database's counts of a host, and the time of its newest stored event on the host's clock; `None` if that
    /// time is unknown.
    Stored(HostId, StoredCounts, Option<WallTime>),
    /// A duplicate batch arrived.
    Duplicate(HostId),
    /// A batch arrived for which the queue of batches to store had no capacity.
    Deferred(HostId),
    /// A batch arrived that does not match its hash.
    Damaged(HostId),
    /// A frame arrived that cannot be decoded.
    Unreadable,
    /// A message arrived from a host without a session on its connection.
    Stranger,
    /// A host without stored events disconnected.
    Forget(HostId),
    /// A run of a host got its number in the store.
    Run(HostId, RunId, i64),
    /// The database was reopened and may be another database.
    Reopened {
        /// Numbers of the newest runs in the database, with their hosts.
        runs: Vec<(HostId, RunId, i64)>,
        /// Counts of each host in the database.
        hosts: Vec<(HostId, StoredCounts)>,
    },
}

/// The state from which snapshots are made.
#[derive(Debug)]
pub(crate) struct LiveTracker {
    aggregator: Slug,
    listening: String,
    /// Silence after which a host is removed from the live state.
    host_timeout: Span,
    hosts: HashMap<HostId, Host>,
    refused_hosts: VecDeque<(Stamp, RefusedHost)>,
    /// Numbers of the runs in the store, by the host and the id under which the host reports the run.
    run_numbers: HashMap<(HostId, RunId), i64>,
    /// Stored counts of hosts that are not in the live state.
    stored_counts: HashMap<HostId, StoredCounts>,
    totals: Totals,
}

impl LiveTracker {
    /// Creates an empty live state. A host that is silent for `host_timeout` is removed.
    pub(crate) fn new(aggregator: Slug, listening: String, host_timeout: Span) -> Self {
        Self {
            aggregator,
            listening,
            host_timeout,
            hosts: HashMap::new(),
            refused_hosts: VecDeque::new(),
            run_numbers: HashMap::new(),
            stored_counts: HashMap::new(),
            totals: Totals::default(),
        }
    }

    /// Applies an event. Returns whether anything visible changed.
    pub(crate) fn apply(&mut self, event: LiveEvent, now: Stamp) -> bool {
        match event {
            LiveEvent::Hello(description, process) => self.introduce(*description, process, now),
            LiveEvent::Refused(refused) => self.record_refusal(refused, now),
            LiveEvent::Reopened { runs, hosts } => self.replace_stored(runs, hosts),
            LiveEvent::Run(host, run, number) => {
                // A hostile agent can start any number of runs.
                if self.run_numbers.len() >= MAX_RUN_NUMBERS {
                    self.forget_numbers();
                }
                self.run_numbers.insert((host, run), number);
                self.update_host(host, |host| host.refresh_run(run));
            }
            LiveEvent::Forget(host) => {
                let is_unstored = self.hosts.get(&host).is_some_and(|host| !host.has_stored_events());
                if is_unstored {
                    self.hosts.remove(&host);
                }
                return is_unstored;
            }
            LiveEvent::Update(update) => {
                return self.update_host(update.host, |host| host.update(*update, now));
            }
            LiveEvent::Goodbye(host) => return self.update_host(host, Host::goodbye),
            LiveEvent::Duplicate(host) => {
                self.totals.stored.duplicates += 1;
                return self.update_host(host, Host::record_duplicate);
            }
            LiveEvent::Deferred(host) => {
                self.totals.rejected_batches.deferred += 1;
                return self.update_host(host, |host| host.record_rejected(|counts| counts.deferred += 1));
            }
            LiveEvent::Damaged(host) => {
                self.totals.rejected_batches.damaged += 1;
                return self.update_host(host, |host| host.record_rejected(|counts| counts.damaged += 1));
            }
            LiveEvent::Unreadable => self.totals.refused.unreadable += 1,
            LiveEvent::Stranger => self.totals.refused.strangers += 1,
            LiveEvent::Stored(host, stored, newest) => return self.update_stored(host, stored, newest),
        }
        true
    }

    /// Discards the numbers of runs that the live state does not show. Discards all numbers if too many remain.
    fn forget_numbers(&mut self) {
        let shown_runs: HashSet<(HostId, RunId)> =
            self.hosts.iter().flat_map(|(id, host)| host.runs().map(|run| (*id, run))).collect();
        self.run_numbers.retain(|run, _| shown_runs.contains(run));
        // With more numbers left, this search would soon be repeated, in the worst case for each new run.
        if self.run_numbers.len() > MAX_RUN_NUMBERS / 2 {
            self.run_numbers.clear();
        }
    }

    /// Replaces the counts and run numbers of the previous database by the values of the reopened database.
    fn replace_stored(&mut self, runs: Vec<(HostId, RunId, i64)>, hosts: Vec<(HostId, StoredCounts)>) {
        self.run_numbers = runs.into_iter().map(|(host, run, number)| ((host, run), number)).collect();
        for host in self.hosts.values_mut() {
            let shown_runs: Vec<RunId> = host.runs().collect();
            shown_runs.into_iter().for_each(|run| host.refresh_run(run));
        }
        let stored_hosts: HashSet<HostId> = hosts.iter().map(|(host, _)| *host).collect();
        self.stored_counts.retain(|host, _| stored_hosts.contains(host));
        let missing_hosts: Vec<HostId> =
            self.hosts.keys().filter(|host| !stored_hosts.contains(host)).copied().collect();
        for host in missing_hosts {
            self.update_stored(host, StoredCounts::default(), None);
        }
        for (host, stored) in hosts {
            self.update_stored(host, stored, None);
        }
    }

    /// Applies the database's counts of a host, and the time of its newest stored event if that time is known. Returns
    /// whether the host is in the live state.
    fn update_stored(&mut self, id: HostId, stored: StoredCounts, newest: Option<WallTime>) -> bool {
        let previous = self.hosts.get(&id).map(Host::stored).or_else(|| self.stored_counts.get(&id).copied());
        // Only the increase is added, so that the totals do not change when a host leaves the live state.
        add_increase(&mut self.totals.stored, previous.unwrap_or_default(), stored);
        let is_live = self.update_host(id, |host| host.update_stored(stored, newest));
        if !is_live {
            self.remember(id, stored);
        }
        is_live
    }

    /// Keeps the stored counts of a host that is not in the live state, for the totals.
    fn remember(&mut self, id: HostId, stored: StoredCounts) {
        if self.stored_counts.len() < MAX_REMEMBERED_HOSTS || self.stored_counts.contains_key(&id) {
            self.stored_counts.insert(id, stored);
        }
    }

    /// Changes a host. Returns `false` if the host is not in the live state.
    fn update_host(&mut self, host: HostId, change: impl FnOnce(&mut Host)) -> bool {
        self.hosts.get_mut(&host).map(change).is_some()
    }

    /// Processes an accepted hello.
    fn introduce(&mut self, description: HostDescription, process: u64, now: Stamp) {
        if let Some(host) = self.hosts.get_mut(&description.id) {
            host.introduce(description, process, now);
            return;
        }
        if self.hosts.len() >= MAX_HOSTS {
            let longest_silent =
                self.hosts.iter().min_by_key(|(_, host)| host.last_seen()).map(|(id, _)| *id);
            if let Some((id, host)) = longest_silent.and_then(|id| self.hosts.remove_entry(&id))
                && host.has_stored_events()
            {
                self.remember(id, host.stored());
            }
        }
        let id = description.id;
        let mut host = Host::new(description, process, now);
        if let Some(stored) = self.stored_counts.remove(&id) {
            host.update_stored(stored, None);
        }
        self.hosts.insert(id, host);
    }

    /// Adds a refused host, or renews its entry.
    fn record_refusal(&mut self, mut refused: RefusedHost, now: Stamp) {
        limits::limit_text(&mut refused.reason);
        let is_same = |entry: &RefusedHost| (&entry.name, &entry.reason) == (&refused.name, &refused.reason);
        self.refused_hosts.retain(|(_, entry)| !is_same(entry));
        // If there are too many, the oldest is dropped.
        self.refused_hosts.truncate(MAX_REFUSED - 1);
        self.refused_hosts.push_front((now, refused));
    }

    /// Applies the passing of time. Returns whether anything visible changed.
    pub(crate) fn expire(&mut self, now: Stamp) -> bool {
        let previous_counts = (self.hosts.len(), self.refused_hosts.len());
        let host_timeout = self.host_timeout;
        let removed_hosts = self.hosts.extract_if(|_, host| {
            let timeout =
                if host.has_stored_events() { host_timeout } else { host_timeout.min(UNSTORED_HOST_TIMEOUT) };
            now.mono - host.last_seen() > timeout
        });
        let removed_hosts: Vec<(HostId, StoredCounts)> =
            removed_hosts.map(|(id, host)| (id, host.stored())).collect();
        removed_hosts
            .into_iter()
            .filter(|(_, stored)| stored.events > 0)
            .for_each(|(id, stored)| self.remember(id, stored));
        self.refused_hosts.retain(|(at, _)| now.mono - at.mono <= REFUSAL_SHOWN_FOR);
        let mut changed = previous_counts != (self.hosts.len(), self.refused_hosts.len());
        for host in self.hosts.values_mut() {
            changed |= host.expire(now, host_timeout);
        }
        changed
    }

    /// Returns a snapshot.
    pub(crate) fn snapshot(&mut self, now: Stamp) -> LiveState {
        let run_numbers = &self.run_numbers;
        let mut sorted_hosts: BTreeMap<_, &mut Host> =
            self.hosts.values_mut().map(|host| (host.sort_key(), host)).collect();
        let mut hosts = Vec::with_capacity(sorted_hosts.len());
        let (mut pipelines, mut links) = (Vec::new(), Vec::new());
        for ((.., id), host) in &mut sorted_hosts {
            let number = |run| run_numbers.get(&(*id, run)).copied();
            hosts.push(host.snapshot());
            pipelines.extend(host.pipelines(number, now));
            links.extend(host.links());
        }
        LiveState {
            at: now.wall,
            aggregator: self.aggregator.clone(),
            listening: self.listening.clone(),
            hosts,
            pipelines,
            links,
            refused: self.refused_hosts.iter().map(|(_, refused)| refused.clone()).collect(),
            absent: self.stored_counts.len(),
            totals: self.totals,
        }
    }

    /// Returns a snapshot to be published.
    pub(crate) fn shared_snapshot(&mut self, now: Stamp) -> Arc<LiveState> {
        Arc::new(self.snapshot(now))
    }
}

/// Adds the increase of a host's stored counts to the totals. Saturates, because a host may state any number.
// Duplicates are counted at their arrival. No reader of the totals uses the other counts.
const fn add_increase(total: &mut StoredCounts, previous: StoredCounts, current: StoredCounts) {
    total.events = total.events.saturating_add(current.events.saturating_sub(previous.events));
    total.nodes = total.nodes.saturating_add(current.nodes.saturating_sub(previous.nodes));
    total.gaps = total.gaps.saturating_add(current.gaps.saturating_sub(previous.gaps));
    total.missing = total.missing.saturating_add(current.missing.saturating_sub(previous.missing));
    let quarantined = current.quarantined.saturating_sub(previous.quarantined);
    total.quarantined = total.quarantined.saturating_add(quarantined);
}
