//! Limit of repeated log lines: at most one per minute for each kind, with the number of events.

use std::collections::HashMap;
use std::net::IpAddr;

use crate::{MonoTime, Span};

/// Shortest time between two lines of one kind.
const LINE_INTERVAL: Span = Span::from_seconds(60);
/// Maximum number of kinds that are counted separately. Further kinds share one count.
// A peer that invents kinds must not use up memory.
const MAX_KINDS: usize = 256;

/// Selects which of many similar events are logged: the first event at once, then at most one event per minute, with
/// the number of events since the last line.
#[derive(Debug, Default)]
pub struct LogThrottle {
    kinds: HashMap<(String, Option<IpAddr>), KindCount>,
}

#[derive(Debug)]
struct KindCount {
    logged_at: MonoTime,
    /// Number of events since the last line.
    unlogged_events: u64,
}

impl LogThrottle {
    /// Counts an event, whose kind is the pair of `reason` and `address`. If a line should be logged now, returns the
    /// number of events of this kind since its last line. `None` if the last line was written less than a minute ago.
    pub fn count_event(&mut self, reason: &str, address: Option<IpAddr>, now: MonoTime) -> Option<u64> {
        let mut key = (reason.to_owned(), address);
        if !self.kinds.contains_key(&key) && self.kinds.len() >= MAX_KINDS {
            // Kinds with unlogged events stay until `remove_expired` returns their number.
            self.kinds.retain(|_, kind| kind.unlogged_events > 0 || now - kind.logged_at < LINE_INTERVAL);
        }
        if !self.kinds.contains_key(&key) && self.kinds.len() >= MAX_KINDS {
            key = (String::new(), None);
        }
        let Some(kind) = self.kinds.get_mut(&key) else {
            self.kinds.insert(key, KindCount { logged_at: now, unlogged_events: 0 });
            return Some(1);
        };
        kind.unlogged_events += 1;
        if now - kind.logged_at < LINE_INTERVAL {
            return None;
        }
        kind.logged_at = now;
        Some(std::mem::take(&mut kind.unlogged_events))
    }

    /// Removes the kinds whose last line is at least a minute old. Returns the reason, the address and the number of
    /// unlogged events of each removed kind that has unlogged events.
    pub fn remove_expired(&mut self, now: MonoTime) -> Vec<(String, Option<IpAddr>, u64)> {
        let expired = self.kinds.extract_if(|_, kind| now - kind.logged_at >= LINE_INTERVAL);
        expired
            .filter(|(_, kind)| kind.unlogged_events > 0)
            .map(|((reason, address), kind)| (reason, address, kind.unlogged_events))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    #[test]
    fn each_kind_and_address_is_logged_every_minute() {
        let mut throttle = LogThrottle::default();
        let here = "127.0.0.1".parse().ok();
        assert_eq!(throttle.count_event("taken", here, at(0)), Some(1));
        assert_eq!(throttle.count_event("taken", here, at(1)), None);
        assert_eq!(throttle.count_event("taken", None, at(1)), Some(1));
        assert_eq!(throttle.count_event("copied", here, at(1)), Some(1));
        assert_eq!(throttle.count_event("taken", here, at(60)), Some(2));
        assert_eq!(throttle.count_event("taken", here, at(61)), None);
        assert_eq!(throttle.remove_expired(at(120)), [("taken".to_owned(), here, 1)]);
        assert_eq!(throttle.count_event("taken", here, at(120)), Some(1));
    }

    #[test]
    fn full_throttle_forgets_no_unlogged_events() {
        let mut throttle = LogThrottle::default();
        for n in 0..MAX_KINDS {
            throttle.count_event(&n.to_string(), None, at(0));
        }
        throttle.count_event("7", None, at(1));
        assert_eq!(throttle.count_event("another", None, at(90)), Some(1));
        assert_eq!(throttle.remove_expired(at(90)), [("7".to_owned(), None, 1)]);
    }

    #[test]
    fn many_kinds_are_counted_together() {
        let mut throttle = LogThrottle::default();
        let logged =
            (0..10_000).filter(|n| throttle.count_event(&n.to_string(), None, at(0)).is_some()).count();
        // The count that all further kinds share is one more entry.
        assert_eq!((logged, throttle.kinds.len()), (MAX_KINDS + 1, MAX_KINDS + 1));
        assert_eq!(throttle.remove_expired(at(60)), [(String::new(), None, 10_000 - MAX_KINDS as u64 - 1)]);
    }
}
