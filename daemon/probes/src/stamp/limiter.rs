//! Limits of the rate at which a reflector answers.

use std::collections::{HashMap, HashSet};
use std::net::IpAddr;

use peernet_clock::{MonoTime, Span};

use super::counters::Refusal;
use super::recent_map::RecentMap;

/// Minimum number of sources without a session whose rates are remembered.
const MIN_SOURCES: usize = 4096;

/// Rate of all sources without a session together, as a multiple of the rate of one source.
const SHARED_FACTOR: u32 = 10;

/// An IPv4 address or an IPv6 network with a prefix of 64 bits: a single host can have all addresses of such a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Source([u8; 16]);

impl From<IpAddr> for Source {
    fn from(address: IpAddr) -> Self {
        Self(match address.to_canonical() {
            IpAddr::V4(address) => address.to_ipv6_mapped().octets(),
            IpAddr::V6(address) => (u128::from(address) >> 64 << 64).to_be_bytes(),
        })
    }
}

/// A token bucket that holds the tokens of one second and is refilled continuously (generic cell rate algorithm, ITU-T
/// I.371).
#[derive(Clone, Copy, Debug, Default)]
struct TokenBucket {
    /// Time at which the bucket will be full again.
    full_at: MonoTime,
}

impl TokenBucket {
    /// Returns whether a reply may be sent now. The bucket gains a token every `interval`.
    fn has_token(self, interval: Span, now: MonoTime) -> bool {
        // The left side is the time that the bucket would need to become full again after the reply. The bucket holds
        // the tokens of one second, so an empty bucket needs one second.
        self.full_at.max(now) + interval - now <= Span::from_seconds(1)
    }

    fn take(&mut self, interval: Span, now: MonoTime) {
        self.full_at = self.full_at.max(now) + interval;
    }
}

/// Limits the replies per second on two levels.
///
/// A source that has a session with this host has its own bucket. Every other source has a bucket as well, and all of
/// these share one further bucket. Packets with forged source addresses, however many, are therefore answered at the
/// rate of the shared bucket and take nothing from the sources with a session. The table of the other sources is
/// bounded; it drops the least recently used sources.
#[derive(Debug)]
pub struct Limiter {
    /// Buckets of sources with a session.
    peers: HashMap<Source, TokenBucket>,
    other_sources: RecentMap<Source, TokenBucket>,
    shared_bucket: TokenBucket,
    /// Time in which a bucket of one source gains a token.
    interval: Span,
    /// Time in which the shared bucket gains a token.
    shared_interval: Span,
}

impl Limiter {
    /// Creates a limiter with `per_second` replies for each source, at least one, and ten times as many for all sources
    /// without a session together.
    pub fn new(per_second: u32) -> Self {
        // A bucket needs a rate of at least one token per second, because it holds the tokens of one second.
        let interval = |hz: u32| Span::from_nanos(1_000_000_000 / i64::from(hz.max(1)));
        Self {
            peers: HashMap::new(),
            other_sources: RecentMap::new(MIN_SOURCES),
            shared_bucket: TokenBucket::default(),
            interval: interval(per_second),
            shared_interval: interval(per_second.max(1).saturating_mul(SHARED_FACTOR)),
        }
    }

    /// Replaces the addresses with a session. An address keeps the contents of its bucket, so that reopening a session
    /// does not refill the bucket.
    pub fn set_peers(&mut self, addresses: &[IpAddr]) {
        let sources: HashSet<Source> = addresses.iter().copied().map(Source::from).collect();
        // A source whose session has ended keeps the contents of its bucket as one of the other sources.
        for (source, bucket) in self.peers.extract_if(|source, _| !sources.contains(source)) {
            *self.other_sources.entry(source, TokenBucket::default) = bucket;
        }
        for source in sources {
            let other_sources = &mut self.other_sources;
            self.peers
                .entry(source)
                .or_insert_with(|| other_sources.get_mut(&source).copied().unwrap_or_default());
        }
    }

    /// Returns whether the address has a session.
    pub fn is_peer(&self, address: IpAddr) -> bool {
        self.peers.contains_key(&Source::from(address))
    }

    /// Counts a reply to `address` if the limits allow it.
    ///
    /// # Errors
    /// The limit that forbids the reply, which is then not counted.
    pub fn admit(&mut self, address: IpAddr, now: MonoTime) -> Result<(), Refusal> {
        let source = Source::from(address);
        if let Some(bucket) = self.peers.get_mut(&source) {
            if !bucket.has_token(self.interval, now) {
                return Err(Refusal::TooOften);
            }
            bucket.take(self.interval, now);
            return Ok(());
        }
        // The shared bucket is checked first, so that a flood of forged addresses does not even enter the table.
        if !self.shared_bucket.has_token(self.shared_interval, now) {
            return Err(Refusal::TooMany);
        }
        let bucket = self.other_sources.entry(source, TokenBucket::default);
        if !bucket.has_token(self.interval, now) {
            return Err(Refusal::TooOften);
        }
        bucket.take(self.interval, now);
        self.shared_bucket.take(self.shared_interval, now);
        Ok(())
    }
}
