//! Complaining about a peer at most once a minute, however much it sends.

use std::collections::HashMap;
use std::net::IpAddr;

use peernet_clock::{MonoTime, Span};

const PAUSE: Span = Span::from_seconds(60);

/// Peers remembered at once; those beyond share one entry, so that many addresses cannot fill memory or the log.
const REMEMBERED: usize = 1024;

/// Who was complained about, and when.
#[derive(Debug, Default)]
pub(crate) struct Complaints {
    last: HashMap<Option<IpAddr>, (MonoTime, u64)>,
}

impl Complaints {
    /// Whether to complain about `peer` now; if so, how many complaints were swallowed since the last.
    pub(crate) fn about(&mut self, peer: Option<IpAddr>, now: MonoTime) -> Option<u64> {
        if self.last.len() >= REMEMBERED && !self.last.contains_key(&peer) {
            self.last.retain(|_, (at, _)| now - *at < PAUSE);
        }
        let key = if self.last.len() >= REMEMBERED && !self.last.contains_key(&peer) { None } else { peer };
        let Some((at, swallowed)) = self.last.get_mut(&key) else {
            self.last.insert(key, (now, 0));
            return Some(0);
        };
        if now - *at < PAUSE {
            *swallowed += 1;
            return None;
        }
        *at = now;
        Some(std::mem::take(swallowed))
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    fn peer(n: u32) -> Option<IpAddr> {
        Some(IpAddr::V4(Ipv4Addr::from_bits(n)))
    }

    #[test]
    fn one_complaint_a_minute_per_peer_and_the_rest_is_counted() {
        let mut complaints = Complaints::default();
        let start = MonoTime::from_nanos(0);
        assert_eq!(complaints.about(peer(1), start), Some(0));
        assert_eq!(complaints.about(peer(2), start), Some(0));
        assert_eq!(complaints.about(peer(1), start + Span::from_seconds(59)), None);
        assert_eq!(complaints.about(peer(1), start + Span::from_seconds(59)), None);
        assert_eq!(complaints.about(peer(1), start + Span::from_seconds(60)), Some(2));
        assert_eq!(complaints.about(peer(1), start + Span::from_seconds(61)), None);
    }

    #[test]
    fn a_flood_of_addresses_neither_grows_nor_complains_without_end() {
        let mut complaints = Complaints::default();
        let said = (0..10_000).filter_map(|n| complaints.about(peer(n), MonoTime::from_nanos(0))).count();
        assert_eq!(said, REMEMBERED + 1);
        assert_eq!(complaints.last.len(), REMEMBERED + 1);
        assert_eq!(complaints.about(peer(77_777), MonoTime::default() + Span::from_seconds(61)), Some(0));
        assert_eq!(complaints.last.len(), 1);
    }
}
