//! The known hosts: stored hosts with their secrets, and newcomers.
//!
//! A newcomer is a host whose hello was accepted and of which nothing is stored yet. A newcomer exists only in memory
//! and only while it is connected; its first batch makes it a stored host. Therefore hosts that somebody invents do not
//! fill the database or the pages. The number of newcomers is limited to `max_hosts`; beyond that, the oldest newcomer
//! is dropped. A genuine agent has its first event stored within a second.

use std::collections::HashMap;

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;
use peernet_stream::{HostSecret, MissingBatches};

use peernet_store::writing::Introduction;

/// Shortest interval between two reads of a host's secret from the database. A wrong proof causes such a read, because
/// an operator may have cleared the secret; the interval limits the reads that somebody who guesses secrets can cause.
const CHECK_INTERVAL: Span = Span::from_seconds(1);

/// The known hosts.
#[derive(Debug)]
pub(crate) struct Hosts {
    /// Maximum number of stored hosts, and of newcomers.
    max_hosts: usize,
    stored_hosts: HashMap<HostId, StoredHost>,
    newcomers: HashMap<HostId, Newcomer>,
    /// Number of the latest newcomer in the order of arrival.
    last_arrival_number: u64,
}

/// A host that is in the database.
#[derive(Debug)]
struct StoredHost {
    /// Rank by age in the database: smaller for a host that has been stored longer.
    seniority: u64,
    /// The host's secret; `None` for a host of an earlier version or after an operator cleared it.
    secret: Option<HostSecret>,
    /// Time of the last read of the secret after a wrong proof.
    secret_read_at: Option<MonoTime>,
}

/// A host whose hello was accepted and of which nothing is stored.
#[derive(Clone, Debug)]
pub(super) struct Newcomer {
    /// The host's introduction, with the secret that it proved to have.
    pub(super) introduction: Introduction,
    /// Batches that the agent no longer holds and that are not in the database.
    pub(super) missing: Option<MissingBatches>,
    /// Number in the order of arrival.
    arrival_number: u64,
}

impl Hosts {
    /// Creates the table of the known hosts. `stored` are the hosts in the database, oldest first. At most `max_hosts`
    /// hosts are stored.
    pub(crate) fn new(max_hosts: usize, stored: Vec<(HostId, Option<HostSecret>)>) -> Self {
        let mut hosts = Self {
            max_hosts,
            stored_hosts: HashMap::new(),
            newcomers: HashMap::new(),
            last_arrival_number: 0,
        };
        hosts.replace_stored(stored);
        hosts
    }

    /// Replaces the stored hosts after the database was reopened. Newcomers are dropped and have to send their hello
    /// again.
    pub(super) fn replace_stored(&mut self, stored: Vec<(HostId, Option<HostSecret>)>) {
        self.newcomers.clear();
        let stored = (0..).zip(stored);
        let stored = stored.map(|(seniority, (host, secret))| {
            (host, StoredHost { seniority, secret, secret_read_at: None })
        });
        self.stored_hosts = stored.collect();
    }

    /// Returns the reason for refusing a host that is not stored, if the number of stored hosts has reached its limit.
    pub(super) fn limit_refusal(&self, host: HostId) -> Option<String> {
        let is_full = !self.is_stored(host) && self.stored_hosts.len() >= self.max_hosts;
        is_full.then(|| {
            format!(
                "{} hosts are stored, the maximum of [aggregator] max_hosts: raise max_hosts to admit another host. \
                 Until then this agent keeps its events",
                self.stored_hosts.len()
            )
        })
    }

    /// Returns whether a host is in the database.
    pub(super) fn is_stored(&self, host: HostId) -> bool {
        self.stored_hosts.contains_key(&host)
    }

    /// Returns whether a host is connected and not stored yet.
    pub(super) fn is_newcomer(&self, host: HostId) -> bool {
        self.newcomers.contains_key(&host)
    }

    /// Returns the host's rank by age, smaller for a host that has been stored longer; `None` if it is not stored.
    pub(super) fn seniority(&self, host: HostId) -> Option<u64> {
        self.stored_hosts.get(&host).map(|host| host.seniority)
    }

    /// Returns the host's secret; `None` if no secret is known.
    pub(super) fn secret(&self, host: HostId) -> Option<&HostSecret> {
        match self.stored_hosts.get(&host) {
            Some(stored) => stored.secret.as_ref(),
            None => self.newcomers.get(&host)?.introduction.secret.as_ref(),
        }
    }

    /// Records the secret that a stored host has proven to have, if the host has no secret: an operator cleared it, or
    /// the host was stored by an earlier version.
    pub(super) fn enrol(&mut self, host: HostId, secret: &HostSecret) {
        if let Some(stored) = self.stored_hosts.get_mut(&host) {
            // A known secret is never replaced; only an operator can clear it.
            stored.secret.get_or_insert_with(|| secret.clone());
        }
    }

    /// Returns whether the host's secret has to be read from the database again after a wrong proof: an operator may
    /// have cleared it. Returns `true` at most once per `CHECK_INTERVAL`, and never for a host that is not stored.
    pub(super) fn needs_secret_check(&mut self, host: HostId, now: MonoTime) -> bool {
        let Some(stored) = self.stored_hosts.get_mut(&host) else { return false };
        let is_due = stored.secret_read_at.is_none_or(|at| now - at >= CHECK_INTERVAL);
        if is_due {
            stored.secret_read_at = Some(now);
        }
        is_due
    }

    /// Replaces the host's secret with the secret in the database.
    pub(super) fn set_secret(&mut self, host: HostId, secret: Option<HostSecret>) {
        if let Some(stored) = self.stored_hosts.get_mut(&host) {
            stored.secret = secret;
        }
    }

    /// Adds a host of which nothing is stored. What an earlier hello of the same stream revealed is kept: a replaced
    /// stream and missing batches. Returns the newcomer that was dropped: the host's earlier entry if that entry has
    /// another stream, or the oldest newcomer if there are too many newcomers.
    pub(super) fn add_newcomer(
        &mut self,
        introduction: Introduction,
        missing: Option<MissingBatches>,
    ) -> Option<Newcomer> {
        let host = introduction.host.id;
        self.last_arrival_number += 1;
        let mut newcomer = Newcomer { introduction, missing, arrival_number: self.last_arrival_number };
        let earlier_entry = self.newcomers.remove(&host);
        let mut dropped_newcomer = None;
        match earlier_entry {
            // A replaced stream or missing batches that the first hello revealed would otherwise be forgotten: later
            // hellos do not report them again.
            Some(earlier) if earlier.introduction.stream == newcomer.introduction.stream => {
                let (new, old) = (&mut newcomer.introduction, earlier.introduction);
                new.replaced = new.replaced.or(old.replaced);
                new.missing_previous = new.missing_previous.or(old.missing_previous);
                newcomer.missing = newcomer.missing.or(earlier.missing);
            }
            Some(earlier) => dropped_newcomer = Some(earlier),
            None if self.newcomers.len() >= self.max_hosts => {
                let oldest = self.newcomers.iter().min_by_key(|(_, newcomer)| newcomer.arrival_number);
                let oldest = oldest.map(|(host, _)| *host);
                dropped_newcomer = oldest.and_then(|oldest| self.newcomers.remove(&oldest));
            }
            None => {}
        }
        self.newcomers.insert(host, newcomer);
        dropped_newcomer
    }

    /// Turns a newcomer into a stored host, because its first batch is about to be stored. Returns `None` if the host
    /// is no newcomer.
    pub(super) fn promote_newcomer(&mut self, host: HostId) -> Option<Newcomer> {
        let newcomer = self.newcomers.remove(&host)?;
        let seniority = self.stored_hosts.values().map(|host| host.seniority + 1).max().unwrap_or(0);
        let secret = newcomer.introduction.secret.clone();
        self.stored_hosts.insert(host, StoredHost { seniority, secret, secret_read_at: None });
        Some(newcomer)
    }

    /// Removes a newcomer and returns it; `None` if the host is no newcomer.
    pub(super) fn remove_newcomer(&mut self, host: HostId) -> Option<Newcomer> {
        self.newcomers.remove(&host)
    }

    /// Returns the newcomers for which `predicate` is true.
    pub(super) fn select_newcomers(&self, predicate: impl Fn(HostId) -> bool) -> Vec<HostId> {
        self.newcomers.keys().copied().filter(|host| predicate(*host)).collect()
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
            previous_stream: None,
            first: 1,
            replaced: None,
            missing_previous: None,
            secret: Some(HostSecret::random()),
        }
    }

    #[test]
    fn number_of_newcomers_is_limited() {
        let mut hosts = Hosts::new(1_000, Vec::new());
        let dropped =
            (0..20_000).filter(|_| hosts.add_newcomer(introduction(HostId::random()), None).is_some());
        assert_eq!(dropped.count(), 19_000);
        assert_eq!((hosts.newcomers.len(), hosts.stored_hosts.len()), (1_000, 0));
    }

    #[test]
    fn full_table_refuses_only_hosts_that_are_not_stored() {
        let first = HostId::random();
        let mut hosts = Hosts::new(2, vec![(first, None)]);
        let second = HostId::random();
        assert_eq!(hosts.limit_refusal(second), None);
        hosts.add_newcomer(introduction(second), None);
        assert!(hosts.promote_newcomer(second).is_some() && hosts.seniority(first) < hosts.seniority(second));
        let refusal = hosts.limit_refusal(HostId::random()).expect("the table is full");
        assert!(refusal.contains("max_hosts"), "{refusal}");
        assert_eq!((hosts.limit_refusal(first), hosts.limit_refusal(second)), (None, None));
    }

    #[test]
    fn cleared_secret_is_replaced_after_reread() {
        let (host, at) = (HostId::random(), |seconds| MonoTime::from_nanos(0) + Span::from_seconds(seconds));
        let mut hosts = Hosts::new(1, vec![(host, Some(HostSecret::random()))]);
        assert!(hosts.needs_secret_check(host, at(0)));
        assert!(
            !hosts.needs_secret_check(host, at(0)),
            "a second wrong proof within a second causes no query"
        );
        assert!(hosts.needs_secret_check(host, at(1)));
        hosts.set_secret(host, None);
        assert_eq!(hosts.secret(host), None);
        let secret = HostSecret::random();
        hosts.enrol(host, &secret);
        assert_eq!(hosts.secret(host), Some(&secret));
    }
}
