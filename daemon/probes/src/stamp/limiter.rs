//! How often each source is answered.

use std::net::{IpAddr, SocketAddr};

use peernet_clock::{MonoTime, Span};

use super::recent::Recent;

/// Sources that are remembered at least.
const SOURCES: usize = 4096;

/// A bucket of tokens for each source: one second's worth, refilled steadily.
///
/// A source is an IPv4 address or an IPv6 network of 64 bits, because that much belongs to any single host. The table
/// is bounded and forgets whoever asked least recently: forged sources in great number can give a forgotten one a new
/// bucket, but cannot make the reflector refuse anybody else. A limit for all together is left out for that reason.
#[derive(Debug)]
pub struct Limiter {
    /// When the bucket would be full again (the generic cell rate algorithm, ITU-T I.371).
    full: Recent<[u8; 16], MonoTime>,
    interval: Span,
}

impl Limiter {
    /// At most `per_second` for each source, at least one.
    pub fn new(per_second: u32) -> Self {
        let interval = Span::from_nanos(1_000_000_000 / i64::from(per_second.max(1)));
        Self { full: Recent::new(SOURCES), interval }
    }

    /// Whether a packet from `source` may be answered now; if so, it is counted.
    pub fn allows(&mut self, source: SocketAddr, now: MonoTime) -> bool {
        let full = self.full.entry(source_of(source.ip()), || now);
        let next = (*full).max(now) + self.interval;
        let allowed = next - now <= Span::from_seconds(1).max(self.interval);
        if allowed {
            *full = next;
        }
        allowed
    }
}

fn source_of(address: IpAddr) -> [u8; 16] {
    match address.to_canonical() {
        IpAddr::V4(address) => address.to_ipv6_mapped().octets(),
        IpAddr::V6(address) => (u128::from(address) >> 64 << 64).to_be_bytes(),
    }
}
