//! The live picture: state of all agents from the live lane alone, so that it stays live whatever waits to be
//! stored. No I/O here; [`task`] owns the one [`Live`] and publishes its pictures.
//!
//! Memory is bounded whatever is sent: so many hosts, so many pipelines and links a host, so many names a second.
//! What is beyond is left out and counted.

mod cell;
mod host;
mod link;
mod pipeline;
pub(crate) mod task;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

use peernet_clock::{Span, Stamp, WallTime};
use peernet_logger::stream::{HostDescription, LiveUpdate};
use peernet_logger::{HostId, RunId, Slug};

use self::host::Host;
use crate::picture::{Picture, RefusedHost, Stored};

/// Hosts in the picture; beyond, the one that was silent for longest gives way.
const MOST_HOSTS: usize = 4_096;
/// A host of which nothing is stored leaves the picture after this silence.
const FORGET_STRANGERS: Span = Span::from_seconds(600);
/// Pipelines of one host.
const MOST_PIPELINES: usize = 256;
/// Links of one host.
const MOST_LINKS: usize = 64;
/// Names of one pipeline within one window.
const MOST_NAMES: usize = 128;
/// Refused hosts that are remembered, and for how long.
const MOST_REFUSED: usize = 32;
const REFUSED_FOR: Span = Span::from_seconds(600);
/// Numbers of runs that are remembered.
const MOST_RUNS: usize = 10_000;

/// What the picture is made from.
#[derive(Debug)]
pub(crate) enum News {
    /// A host was let in.
    Hello(Box<HostDescription>),
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
    /// The store's number of a run.
    Run(RunId, i64),
}

/// The state behind the picture.
#[derive(Debug)]
pub(crate) struct Live {
    aggregator: Slug,
    listening: String,
    forget: Span,
    hosts: HashMap<HostId, Host>,
    refused: VecDeque<(Stamp, RefusedHost)>,
    numbers: HashMap<RunId, i64>,
    /// What the database holds of hosts that have not come yet.
    stored: HashMap<HostId, Stored>,
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
        }
    }

    /// Takes in news; whether they change anything to be seen.
    pub(crate) fn take(&mut self, news: News, now: Stamp) -> bool {
        match news {
            News::Hello(description) => self.introduce(*description, now),
            News::Refused(refused) => self.refuse(refused, now),
            News::Run(run, number) => {
                if self.numbers.len() >= MOST_RUNS {
                    self.numbers.clear();
                }
                self.numbers.insert(run, number);
                self.hosts.values_mut().for_each(|host| host.number(run));
            }
            News::Update(update) => return self.with(update.host, |host| host.update(*update, now)),
            News::Goodbye(host) => return self.with(host, Host::goodbye),
            News::Duplicate(host) => return self.with(host, Host::duplicate),
            News::Stored(host, stored, newest) => {
                let known = self.with(host, |host| host.store(stored, newest));
                if !known && self.stored.len() < MOST_HOSTS {
                    self.stored.insert(host, stored);
                }
                return known;
            }
        }
        true
    }

    fn with(&mut self, host: HostId, change: impl FnOnce(&mut Host)) -> bool {
        self.hosts.get_mut(&host).map(change).is_some()
    }

    fn introduce(&mut self, description: HostDescription, now: Stamp) {
        if let Some(host) = self.hosts.get_mut(&description.id) {
            host.introduce(description, now);
            return;
        }
        if self.hosts.len() >= MOST_HOSTS {
            let silent = self.hosts.iter().min_by_key(|(_, host)| host.seen()).map(|(id, _)| *id);
            silent.and_then(|id| self.hosts.remove(&id));
        }
        let id = description.id;
        let mut host = Host::new(description, now);
        if let Some(stored) = self.stored.remove(&id) {
            host.store(stored, None);
        }
        self.hosts.insert(id, host);
    }

    fn refuse(&mut self, refused: RefusedHost, now: Stamp) {
        let same = |known: &RefusedHost| (&known.name, &known.reason) == (&refused.name, &refused.reason);
        self.refused.retain(|(_, known)| !same(known));
        self.refused.truncate(MOST_REFUSED - 1);
        self.refused.push_front((now, refused));
    }

    /// Lets time pass; whether that changed anything to be seen.
    pub(crate) fn age(&mut self, now: Stamp) -> bool {
        let before = (self.hosts.len(), self.refused.len());
        let forget = self.forget;
        self.hosts.retain(|_, host| {
            let patience = if host.has_stored() { forget } else { forget.min(FORGET_STRANGERS) };
            now.mono - host.seen() <= patience
        });
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
        let number = |run| numbers.get(&run).copied();
        let mut by_name: BTreeMap<(Slug, HostId), &mut Host> =
            self.hosts.iter_mut().map(|(id, host)| ((host.name().clone(), *id), host)).collect();
        let mut hosts = Vec::with_capacity(by_name.len());
        let (mut pipelines, mut links) = (Vec::new(), Vec::new());
        for host in by_name.values_mut() {
            hosts.push(host.picture());
            pipelines.extend(host.pipelines(&number, now));
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
        }
    }

    /// A picture to be handed out.
    pub(crate) fn shared(&mut self, now: Stamp) -> Arc<Picture> {
        Arc::new(self.picture(now))
    }
}
