//! How many probes a reflector answers.

use std::collections::{HashMap, HashSet};
use std::net::IpAddr;

use peernet_clock::{MonoTime, Span};

use super::figures::Refusal;
use super::recent::Recent;

/// Sources without a session whose rate is remembered at least.
const SOURCES: usize = 4096;

/// What all sources without a session may ask for together, as a multiple of what one may ask for.
const SHARED_FACTOR: u32 = 10;

/// An IPv4 address or an IPv6 network of 64 bits, because that much belongs to any single host.
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

/// A bucket of tokens that holds one second's worth and is refilled steadily (the generic cell rate algorithm,
/// ITU-T I.371).
#[derive(Clone, Copy, Debug, Default)]
struct TokenBucket {
    /// When the bucket would be full again.
    full: MonoTime,
}

impl TokenBucket {
    fn has_token(self, interval: Span, now: MonoTime) -> bool {
        self.full.max(now) + interval - now <= Span::from_seconds(1).max(interval)
    }

    fn take(&mut self, interval: Span, now: MonoTime) {
        self.full = self.full.max(now) + interval;
    }
}

/// Limits the replies per second in two levels.
///
/// A source that has a session with this host has a bucket of its own. All other sources have a bucket each and share
/// one more, so that forged source addresses in any number are answered at the rate of that one bucket and take nothing
/// from the sources with a session. The table of the others is bounded and forgets whoever asked least recently.
#[derive(Debug)]
pub struct Limiter {
    peers: HashMap<Source, TokenBucket>,
    others: Recent<Source, TokenBucket>,
    shared: TokenBucket,
    interval: Span,
    shared_interval: Span,
}

impl Limiter {
    /// At most `per_second` replies for each source, at least one, and ten times as many for all sources without a
    /// session together.
    pub fn new(per_second: u32) -> Self {
        let interval = |hz: u32| Span::from_nanos(1_000_000_000 / i64::from(hz.max(1)));
        Self {
            peers: HashMap::new(),
            others: Recent::new(SOURCES),
            shared: TokenBucket::default(),
            interval: interval(per_second),
            shared_interval: interval(per_second.max(1).saturating_mul(SHARED_FACTOR)),
        }
    }

    /// Replaces the addresses that have a session. An address that was known before keeps what is left in its bucket, so
    /// that opening sessions again and again gains nothing.
    pub fn set_peers(&mut self, addresses: &[IpAddr]) {
        let sources: HashSet<Source> = addresses.iter().copied().map(Source::from).collect();
        for (source, bucket) in self.peers.extract_if(|source, _| !sources.contains(source)) {
            *self.others.entry(source, TokenBucket::default) = bucket;
        }
        for source in sources {
            let others = &mut self.others;
            self.peers.entry(source).or_insert_with(|| others.get_mut(&source).copied().unwrap_or_default());
        }
    }

    /// Whether the address has a session.
    pub fn is_peer(&self, address: IpAddr) -> bool {
        self.peers.contains_key(&Source::from(address))
    }

    /// Counts a reply to `address`.
    ///
    /// # Errors
    /// The limit that forbids it; the reply is not counted then.
    pub fn admit(&mut self, address: IpAddr, now: MonoTime) -> Result<(), Refusal> {
        let source = Source::from(address);
        if let Some(bucket) = self.peers.get_mut(&source) {
            if !bucket.has_token(self.interval, now) {
                return Err(Refusal::TooOften);
            }
            bucket.take(self.interval, now);
            return Ok(());
        }
        // First, so that a flood of forged addresses does not even enter the table.
        if !self.shared.has_token(self.shared_interval, now) {
            return Err(Refusal::TooMany);
        }
        let bucket = self.others.entry(source, TokenBucket::default);
        if !bucket.has_token(self.interval, now) {
            return Err(Refusal::TooOften);
        }
        bucket.take(self.interval, now);
        self.shared.take(self.shared_interval, now);
        Ok(())
    }
}
