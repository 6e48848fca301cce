//! Events that repeat: one log line a minute for each kind, with a count.

use std::collections::HashMap;
use std::net::IpAddr;

use peernet_clock::{MonoTime, Span};

/// Between two lines about the same.
const LINE_EVERY: Span = Span::from_seconds(60);
/// Kinds told apart; beyond, they are counted together.
const MOST: usize = 256;

/// Decides which of many equal events is logged: the first at once, then one a minute with the number of those between.
#[derive(Debug, Default)]
pub struct LogThrottle {
    known: HashMap<(String, Option<IpAddr>), Known>,
}

#[derive(Debug)]
struct Known {
    said: MonoTime,
    since: u64,
}

impl LogThrottle {
    /// Counts an event by its kind and the address it comes from. Returns how often it happened since it was last logged;
    /// `None` when that was less than a minute ago.
    pub fn count(&mut self, reason: &str, address: Option<IpAddr>, now: MonoTime) -> Option<u64> {
        let mut key = (reason.to_owned(), address);
        if !self.known.contains_key(&key) && self.known.len() >= MOST {
            self.known.retain(|_, known| known.since > 0 || now - known.said < LINE_EVERY);
        }
        if !self.known.contains_key(&key) && self.known.len() >= MOST {
            key = (String::new(), None);
        }
        let Some(known) = self.known.get_mut(&key) else {
            self.known.insert(key, Known { said: now, since: 0 });
            return Some(1);
        };
        known.since += 1;
        if now - known.said < LINE_EVERY {
            return None;
        }
        known.said = now;
        Some(std::mem::take(&mut known.since))
    }

    /// Forgets what no longer happens. Returns how many events were not logged, by kind and address.
    pub fn age(&mut self, now: MonoTime) -> Vec<(String, Option<IpAddr>, u64)> {
        let old = self.known.extract_if(|_, known| now - known.said >= LINE_EVERY);
        old.filter(|(_, known)| known.since > 0)
            .map(|((reason, address), known)| (reason, address, known.since))
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
    fn each_reason_and_address_is_said_once_a_minute_and_nothing_goes_uncounted() {
        let mut refusals = LogThrottle::default();
        let here = "127.0.0.1".parse().ok();
        assert_eq!(refusals.count("taken", here, at(0)), Some(1));
        assert_eq!(refusals.count("taken", here, at(1)), None);
        assert_eq!(refusals.count("taken", None, at(1)), Some(1));
        assert_eq!(refusals.count("copied", here, at(1)), Some(1));
        assert_eq!(refusals.count("taken", here, at(60)), Some(2));
        assert_eq!(refusals.count("taken", here, at(61)), None);
        assert_eq!(refusals.age(at(120)), [("taken".to_owned(), here, 1)]);
        assert_eq!(refusals.count("taken", here, at(120)), Some(1));
    }

    #[test]
    fn whoever_invents_reasons_takes_no_memory() {
        let mut refusals = LogThrottle::default();
        let said = (0..10_000).filter(|n| refusals.count(&n.to_string(), None, at(0)).is_some()).count();
        assert_eq!((said, refusals.known.len()), (MOST + 1, MOST + 1));
        assert_eq!(refusals.age(at(60)), [(String::new(), None, 10_000 - MOST as u64 - 1)]);
    }
}
