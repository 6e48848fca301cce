//! The hosts that are known: those of which something is stored, with their secrets, and newcomers.
//!
//! A newcomer is a host that was let in and of which nothing is stored yet. It is kept in memory while it is connected and
//! nowhere else; its first batch makes it a host that is stored. So whoever invents hosts fills neither the database nor
//! the pages: there are as many newcomers as hosts may be stored, and beyond that the one that came first makes way. An agent
//! stores its first event within a second.

use std::collections::HashMap;

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;
use peernet_stream::{HostSecret, Missing};

use peernet_store::writing::Introduction;

/// How often the secret of one host is read from the database again because a proof was wrong.
const CHECK_EVERY: Span = Span::from_seconds(1);

/// The hosts that are known.
#[derive(Debug)]
pub(crate) struct Hosts {
    most: usize,
    stored: HashMap<HostId, StoredHost>,
    newcomers: HashMap<HostId, Newcomer>,
    /// Newcomers that came so far.
    came: u64,
}

#[derive(Debug)]
struct StoredHost {
    /// Smaller for a host that has been stored for longer.
    seniority: u64,
    /// `None` for a host of an earlier version, or after an operator cleared it.
    secret: Option<HostSecret>,
    checked: Option<MonoTime>,
}

/// A host that was let in and of which nothing is stored.
#[derive(Clone, Debug)]
pub(super) struct Newcomer {
    /// How it introduced itself, with the secret that it proved to have.
    pub(super) introduction: Introduction,
    /// Batches that it no longer holds and that are not here.
    pub(super) missing: Option<Missing>,
    came: u64,
}

impl Hosts {
    /// The hosts that are stored, those first that came first; no more than `most` are let in.
    pub(crate) fn new(most: usize, stored: Vec<(HostId, Option<HostSecret>)>) -> Self {
        let mut hosts = Self { most, stored: HashMap::new(), newcomers: HashMap::new(), came: 0 };
        hosts.restart(stored);
        hosts
    }

    /// The database is another one, which holds these hosts; newcomers are to come again.
    pub(super) fn restart(&mut self, stored: Vec<(HostId, Option<HostSecret>)>) {
        self.newcomers.clear();
        let stored = (0..).zip(stored);
        let stored =
            stored.map(|(seniority, (host, secret))| (host, StoredHost { seniority, secret, checked: None }));
        self.stored = stored.collect();
    }

    /// Why a host cannot be let in, if it is not known and there are too many.
    pub(super) fn refuses(&self, host: HostId) -> Option<String> {
        let full = !self.is_stored(host) && self.stored.len() >= self.most;
        full.then(|| {
            format!(
                "{} hosts are stored here and [aggregator] max_hosts allows no more: raise max_hosts to let another in. \
                 This agent keeps its events meanwhile",
                self.stored.len()
            )
        })
    }

    pub(super) fn is_stored(&self, host: HostId) -> bool {
        self.stored.contains_key(&host)
    }

    pub(super) fn is_newcomer(&self, host: HostId) -> bool {
        self.newcomers.contains_key(&host)
    }

    /// Smaller for a host that has been stored for longer; `None` for one of which nothing is stored.
    pub(super) fn seniority(&self, host: HostId) -> Option<u64> {
        self.stored.get(&host).map(|host| host.seniority)
    }

    /// The secret that belongs to a host, if one is known.
    pub(super) fn secret(&self, host: HostId) -> Option<&HostSecret> {
        match self.stored.get(&host) {
            Some(stored) => stored.secret.as_ref(),
            None => self.newcomers.get(&host)?.introduction.secret.as_ref(),
        }
    }

    /// A stored host has proven that it has this secret; what an operator cleared is kept anew.
    pub(super) fn enrol(&mut self, host: HostId, secret: &HostSecret) {
        if let Some(stored) = self.stored.get_mut(&host) {
            stored.secret.get_or_insert_with(|| secret.clone());
        }
    }

    /// Whether the secret of a host is to be read from the database again: a proof was wrong, and an operator may have
    /// cleared it.
    pub(super) fn is_to_be_checked(&mut self, host: HostId, now: MonoTime) -> bool {
        let Some(stored) = self.stored.get_mut(&host) else { return false };
        let due = stored.checked.is_none_or(|at| now - at >= CHECK_EVERY);
        if due {
            stored.checked = Some(now);
        }
        due
    }

    /// The secret of a host as it stands in the database.
    pub(super) fn checked(&mut self, host: HostId, secret: Option<HostSecret>) {
        if let Some(stored) = self.stored.get_mut(&host) {
            stored.secret = secret;
        }
    }

    /// A host was let in of which nothing is stored. What was found of the same stream before stays. Returns the newcomer
    /// that makes way.
    pub(super) fn welcome(
        &mut self,
        introduction: Introduction,
        missing: Option<Missing>,
    ) -> Option<Newcomer> {
        let host = introduction.host.id;
        self.came += 1;
        let mut newcomer = Newcomer { introduction, missing, came: self.came };
        let before = self.newcomers.remove(&host);
        let mut gone = None;
        match before {
            Some(before) if before.introduction.stream == newcomer.introduction.stream => {
                let (new, old) = (&mut newcomer.introduction, before.introduction);
                new.replaced = new.replaced.or(old.replaced);
                new.lacking = new.lacking.or(old.lacking);
                newcomer.missing = newcomer.missing.or(before.missing);
            }
            Some(before) => gone = Some(before),
            None if self.newcomers.len() >= self.most => {
                let first = self.newcomers.iter().min_by_key(|(_, newcomer)| newcomer.came);
                let first = first.map(|(host, _)| *host);
                gone = first.and_then(|first| self.newcomers.remove(&first));
            }
            None => {}
        }
        self.newcomers.insert(host, newcomer);
        gone
    }

    /// The first batch of a newcomer is about to be stored, and the host with it.
    pub(super) fn store(&mut self, host: HostId) -> Option<Newcomer> {
        let newcomer = self.newcomers.remove(&host)?;
        let seniority = self.stored.values().map(|host| host.seniority + 1).max().unwrap_or(0);
        let secret = newcomer.introduction.secret.clone();
        self.stored.insert(host, StoredHost { seniority, secret, checked: None });
        Some(newcomer)
    }

    /// A newcomer has gone.
    pub(super) fn forget(&mut self, host: HostId) -> Option<Newcomer> {
        self.newcomers.remove(&host)
    }

    /// Newcomers for which `gone` holds.
    pub(super) fn newcomers_that(&self, gone: impl Fn(HostId) -> bool) -> Vec<HostId> {
        self.newcomers.keys().copied().filter(|host| gone(*host)).collect()
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::ClockIdentity;
    use peernet_stream::{Hardware, HostDescription, StreamId};

    use super::*;

    fn introduction(host: HostId) -> Introduction {
        let host = HostDescription {
            id: host,
            name: "edge".parse().expect("a name"),
            clock: ClockIdentity::new("boot", "system"),
            version: "0.1.0".into(),
            hardware: Hardware::default(),
            serves: None,
            models: Vec::new(),
        };
        Introduction {
            host,
            process: 1,
            stream: StreamId::random(),
            previous: None,
            first: 1,
            replaced: None,
            lacking: None,
            secret: Some(HostSecret::random()),
        }
    }

    #[test]
    fn whoever_invents_hosts_takes_no_memory() {
        let mut hosts = Hosts::new(1_000, Vec::new());
        let gone = (0..20_000).filter(|_| hosts.welcome(introduction(HostId::random()), None).is_some());
        assert_eq!(gone.count(), 19_000);
        assert_eq!((hosts.newcomers.len(), hosts.stored.len()), (1_000, 0));
    }

    #[test]
    fn new_host_is_refused_when_full_and_known_ones_never() {
        let known = HostId::random();
        let mut hosts = Hosts::new(2, vec![(known, None)]);
        let second = HostId::random();
        assert_eq!(hosts.refuses(second), None);
        hosts.welcome(introduction(second), None);
        assert!(hosts.store(second).is_some() && hosts.seniority(known) < hosts.seniority(second));
        let words = hosts.refuses(HostId::random()).expect("it is full");
        assert!(words.contains("max_hosts"), "{words}");
        assert_eq!((hosts.refuses(known), hosts.refuses(second)), (None, None));
    }

    #[test]
    fn cleared_secret_is_forgotten_once_it_was_read_again() {
        let (host, at) = (HostId::random(), |seconds| MonoTime::from_nanos(0) + Span::from_seconds(seconds));
        let mut hosts = Hosts::new(1, vec![(host, Some(HostSecret::random()))]);
        assert!(hosts.is_to_be_checked(host, at(0)));
        assert!(!hosts.is_to_be_checked(host, at(0)), "whoever guesses causes one question a second");
        assert!(hosts.is_to_be_checked(host, at(1)));
        hosts.checked(host, None);
        assert_eq!(hosts.secret(host), None);
        let secret = HostSecret::random();
        hosts.enrol(host, &secret);
        assert_eq!(hosts.secret(host), Some(&secret));
    }
}
