//! The live picture: state of all agents from the live lane alone, so that it stays live whatever waits to be
//! stored. No I/O here; [`task`] owns the one [`Live`] and publishes its pictures.
//!
//! Memory is bounded whatever is sent: so many hosts, so many pipelines and links a host, so many names a second.
//! What is beyond is left out and counted.

pub(crate) mod bounds;
mod catching_up;
mod cell;
mod event_account;
mod host;
mod link;
mod metrics_history;
mod percentiles;
mod pipeline;
mod presence;
pub(crate) mod task;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::sync::Arc;

use peernet_clock::{Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{HostDescription, LiveUpdate};

use self::host::Host;
use crate::picture::{Picture, RefusedHost, Totals};
use peernet_store::Stored;

/// Hosts in the picture; beyond, the one that was silent for longest gives way.
const MOST_HOSTS: usize = 4_096;
/// A host of which nothing is stored leaves the picture after this silence.
const FORGET_STRANGERS: Span = Span::from_seconds(600);
/// Pipelines of one host.
const MOST_PIPELINES: usize = peernet_stream::limits::MAX_PIPELINES;
/// Links of one host.
const MOST_LINKS: usize = 64;
/// Names of one pipeline within one window.
const MOST_NAMES: usize = 128;
/// Refused hosts that are remembered, and for how long.
const MOST_REFUSED: usize = 32;
const REFUSED_FOR: Span = Span::from_seconds(600);
/// Hosts outside the picture of which it is remembered what is stored.
const MOST_REMEMBERED: usize = 65_536;
/// Numbers of runs that are remembered.
const MOST_RUNS: usize = 10_000;

/// What the picture is made from.
#[derive(Debug)]
pub(crate) enum News {
    /// A host was let in, and the number that its process made at its start.
    Hello(Box<HostDescription>, u64),
    /// The live lane.
    Update(Box<LiveUpdate>),
    /// A host took its leave.
    Goodbye(HostId),
    /// A host was turned away.
    Refused(RefusedHost),
    /// What the database holds of a host, and the newest moment of it on the host's clock.
    Stored(HostId, Stored, Option<WallTime>),
    /// A batch came again.
    Duplicate(HostId),
    /// A batch came for which there was no room.
    Deferred(HostId),
    /// A batch came whose bytes do not match its hash.
    Damaged(HostId),
    /// A frame came that is no message.
    Unreadable,
    /// A message came of a host that did not say hello on that connection.
    Stranger,
    /// A host has gone of which nothing is stored.
    Forget(HostId),
    /// The store's number of a run of a host.
    Run(HostId, RunId, i64),
    /// The database was opened anew, and may be another one.
    Reopened {
        /// The numbers of its newest runs, by their hosts.
        runs: Vec<(HostId, RunId, i64)>,
        /// What it holds of hosts.
        hosts: Vec<(HostId, Stored)>,
    },
}

/// The state behind the picture.
#[derive(Debug)]
pub(crate) struct Live {
    aggregator: Slug,
    listening: String,
    forget: Span,
    hosts: HashMap<HostId, Host>,
    refused: VecDeque<(Stamp, RefusedHost)>,
    /// By the host and the id under which it reports the run.
    numbers: HashMap<(HostId, RunId), i64>,
    /// What the database holds of hosts that are not in the picture.
    stored: HashMap<HostId, Stored>,
    totals: Totals,
}

impl Live {
    /// An empty picture; hosts that are silent for `forget` leave it.
    pub(crate) fn new(aggregator: Slug, listening: String, forget: Span) -> Self {
        Self {
            aggregator,
            listening,
            forget,
            hosts: HashMap::new(),
            refused: VecDeque::new(),
            numbers: HashMap::new(),
            stored: HashMap::new(),
            totals: Totals::default(),
        }
    }

    /// Takes in news; whether they change anything to be seen.
    pub(crate) fn take(&mut self, news: News, now: Stamp) -> bool {
        match news {
            News::Hello(description, process) => self.introduce(*description, process, now),
            News::Refused(refused) => self.refuse(refused, now),
            News::Reopened { runs, hosts } => self.restart(runs, hosts),
            News::Run(host, run, number) => {
                if self.numbers.len() >= MOST_RUNS {
                    self.forget_numbers();
                }
                self.numbers.insert((host, run), number);
                self.with(host, |host| host.number(run));
            }
            News::Forget(host) => {
                let forgotten = self.hosts.get(&host).is_some_and(|host| !host.has_stored());
                if forgotten {
                    self.hosts.remove(&host);
                }
                return forgotten;
            }
            News::Update(update) => return self.with(update.host, |host| host.update(*update, now)),
            News::Goodbye(host) => return self.with(host, Host::goodbye),
            News::Duplicate(host) => {
                self.totals.stored.duplicates += 1;
                return self.with(host, Host::duplicate);
            }
            News::Deferred(host) => {
                self.totals.arrivals.deferred += 1;
                return self.with(host, |host| host.arrived(|arrivals| arrivals.deferred += 1));
            }
            News::Damaged(host) => {
                self.totals.arrivals.damaged += 1;
                return self.with(host, |host| host.arrived(|arrivals| arrivals.damaged += 1));
            }
            News::Unreadable => self.totals.refused.unreadable += 1,
            News::Stranger => self.totals.refused.strangers += 1,
            News::Stored(host, stored, newest) => return self.store(host, stored, newest),
        }
        true
    }

    /// Forgets the numbers of runs that nobody sees; all of them if those that are left are too many.
    fn forget_numbers(&mut self) {
        let shown: HashSet<(HostId, RunId)> =
            self.hosts.iter().flat_map(|(id, host)| host.runs().map(|run| (*id, run))).collect();
        self.numbers.retain(|run, _| shown.contains(run));
        if self.numbers.len() > MOST_RUNS / 2 {
            self.numbers.clear();
        }
    }

    /// Forgets what the database before held, and takes in what this one holds.
    fn restart(&mut self, runs: Vec<(HostId, RunId, i64)>, hosts: Vec<(HostId, Stored)>) {
        self.numbers = runs.into_iter().map(|(host, run, number)| ((host, run), number)).collect();
        for host in self.hosts.values_mut() {
            let shown: Vec<RunId> = host.runs().collect();
            shown.into_iter().for_each(|run| host.number(run));
        }
        let held: HashSet<HostId> = hosts.iter().map(|(host, _)| *host).collect();
        self.stored.retain(|host, _| held.contains(host));
        let lacking: Vec<HostId> = self.hosts.keys().filter(|host| !held.contains(host)).copied().collect();
        for host in lacking {
            self.store(host, Stored::default(), None);
        }
        for (host, stored) in hosts {
            self.store(host, stored, None);
        }
    }

    fn store(&mut self, id: HostId, stored: Stored, newest: Option<WallTime>) -> bool {
        let before = self.hosts.get(&id).map(Host::stored).or_else(|| self.stored.get(&id).copied());
        add(&mut self.totals.stored, before.unwrap_or_default(), stored);
        let known = self.with(id, |host| host.store(stored, newest));
        if !known {
            self.remember(id, stored);
        }
        known
    }

    /// Keeps what the database holds of a host that is not in the picture.
    fn remember(&mut self, id: HostId, stored: Stored) {
        if self.stored.len() < MOST_REMEMBERED || self.stored.contains_key(&id) {
            self.stored.insert(id, stored);
        }
    }

    fn with(&mut self, host: HostId, change: impl FnOnce(&mut Host)) -> bool {
        self.hosts.get_mut(&host).map(change).is_some()
    }

    fn introduce(&mut self, description: HostDescription, process: u64, now: Stamp) {
        if let Some(host) = self.hosts.get_mut(&description.id) {
            host.introduce(description, process, now);
            return;
        }
        if self.hosts.len() >= MOST_HOSTS {
            let silent = self.hosts.iter().min_by_key(|(_, host)| host.seen()).map(|(id, _)| *id);
            if let Some((id, host)) = silent.and_then(|id| self.hosts.remove_entry(&id)) {
                self.remember(id, host.stored());
            }
        }
        let id = description.id;
        let mut host = Host::new(description, process, now);
        if let Some(stored) = self.stored.remove(&id) {
            host.store(stored, None);
        }
        self.hosts.insert(id, host);
    }

    fn refuse(&mut self, mut refused: RefusedHost, now: Stamp) {
        bounds::text(&mut refused.reason);
        let same = |known: &RefusedHost| (&known.name, &known.reason) == (&refused.name, &refused.reason);
        self.refused.retain(|(_, known)| !same(known));
        self.refused.truncate(MOST_REFUSED - 1);
        self.refused.push_front((now, refused));
    }

    /// Lets time pass; whether that changed anything to be seen.
    pub(crate) fn age(&mut self, now: Stamp) -> bool {
        let before = (self.hosts.len(), self.refused.len());
        let forget = self.forget;
        let gone = self.hosts.extract_if(|_, host| {
            let patience = if host.has_stored() { forget } else { forget.min(FORGET_STRANGERS) };
            now.mono - host.seen() > patience
        });
        let gone: Vec<(HostId, Stored)> = gone.map(|(id, host)| (id, host.stored())).collect();
        gone.into_iter()
            .filter(|(_, stored)| stored.events > 0)
            .for_each(|(id, stored)| self.remember(id, stored));
        self.refused.retain(|(at, _)| now.mono - at.mono <= REFUSED_FOR);
        let mut changed = before != (self.hosts.len(), self.refused.len());
        for host in self.hosts.values_mut() {
            changed |= host.age(now, forget);
        }
        changed
    }

    /// The picture now.
    pub(crate) fn picture(&mut self, now: Stamp) -> Picture {
        let numbers = &self.numbers;
        let mut by_name: BTreeMap<(Slug, HostId), &mut Host> =
            self.hosts.iter_mut().map(|(id, host)| ((host.name().clone(), *id), host)).collect();
        let mut hosts = Vec::with_capacity(by_name.len());
        let (mut pipelines, mut links) = (Vec::new(), Vec::new());
        for ((_, id), host) in &mut by_name {
            let number = |run| numbers.get(&(*id, run)).copied();
            hosts.push(host.picture());
            pipelines.extend(host.pipelines(number, now));
            links.extend(host.links());
        }
        Picture {
            at: now.wall,
            aggregator: self.aggregator.clone(),
            listening: self.listening.clone(),
            hosts,
            pipelines,
            links,
            refused: self.refused.iter().map(|(_, refused)| refused.clone()).collect(),
            absent: self.stored.len(),
            totals: self.totals,
        }
    }

    /// A picture to be handed out.
    pub(crate) fn shared(&mut self, now: Stamp) -> Arc<Picture> {
        Arc::new(self.picture(now))
    }
}

/// Adds what came to be stored of a host from one account of it to the next. A host may claim any number.
const fn add(total: &mut Stored, before: Stored, now: Stored) {
    total.events = total.events.saturating_add(now.events.saturating_sub(before.events));
    total.nodes = total.nodes.saturating_add(now.nodes.saturating_sub(before.nodes));
    total.gaps = total.gaps.saturating_add(now.gaps.saturating_sub(before.gaps));
    total.missing = total.missing.saturating_add(now.missing.saturating_sub(before.missing));
    total.quarantined = total.quarantined.saturating_add(now.quarantined.saturating_sub(before.quarantined));
}
