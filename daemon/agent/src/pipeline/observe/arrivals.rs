//! Period, jitter and missing messages of one topic. No I/O.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span};

/// Publishers of a topic whose sequence numbers are remembered: anybody on the network can publish.
const MAX_PUBLISHERS: usize = 256;

/// What the arrivals of a topic's messages were like so far.
#[derive(Debug, Default)]
pub(super) struct Arrivals {
    last: Option<MonoTime>,
    last_period: Option<Span>,
    /// The last sequence number of each publisher.
    sequences: BTreeMap<Arc<str>, i64>,
}

/// What one more message says of its topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Arrival {
    /// Time since the message before it.
    pub(super) period: Option<Span>,
    /// Difference between this period and the one before, without its sign.
    pub(super) jitter: Option<Span>,
    /// Messages of the same publisher that should have come before it, by its sequence numbers.
    pub(super) missing: u64,
}

impl Arrivals {
    /// Takes in a message.
    pub(super) fn record(&mut self, at: MonoTime, publisher: &Arc<str>, sequence: Option<i64>) -> Arrival {
        let period = self.last.replace(at).map(|last| at - last);
        let last_period = std::mem::replace(&mut self.last_period, period);
        let jitter = period.zip(last_period).map(|(period, last)| (period - last).abs());
        let missing = sequence.map_or(0, |sequence| self.missing(publisher, sequence));
        Arrival { period, jitter, missing }
    }

    fn missing(&mut self, publisher: &Arc<str>, sequence: i64) -> u64 {
        if self.sequences.len() >= MAX_PUBLISHERS && !self.sequences.contains_key(publisher) {
            self.sequences.clear();
        }
        let last = self.sequences.insert(Arc::clone(publisher), sequence);
        // A lower number is that of a node that was started anew, or of a message that came late.
        last.and_then(|last| u64::try_from(sequence.checked_sub(last)?.checked_sub(1)?).ok()).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn periods_and_their_differences_are_told() {
        let (mut arrivals, node) = (Arrivals::default(), Arc::from("/camera"));
        let mut record = |millis| arrivals.record(at(millis), &node, None);
        assert_eq!(record(0), Arrival::default());
        assert_eq!(record(20), Arrival { period: Some(Span::from_millis(20)), ..Arrival::default() });
        let early = record(35);
        assert_eq!((early.period, early.jitter), (Some(Span::from_millis(15)), Some(Span::from_millis(5))));
    }

    #[test]
    fn missing_messages_are_counted_for_each_publisher() {
        let mut arrivals = Arrivals::default();
        let (left, right): (Arc<str>, Arc<str>) = (Arc::from("/left"), Arc::from("/right"));
        let mut missing = |node, sequence| arrivals.record(at(0), node, Some(sequence)).missing;
        assert_eq!((missing(&left, 7), missing(&right, 100)), (0, 0), "nothing is known of what was before");
        assert_eq!((missing(&left, 8), missing(&right, 104)), (0, 3));
        assert_eq!((missing(&left, 0), missing(&left, 2)), (0, 1), "the node was started anew");
    }

    #[test]
    fn publishers_take_bounded_memory() {
        let mut arrivals = Arrivals::default();
        for number in 0..10_000 {
            arrivals.record(at(0), &Arc::from(format!("/node{number}")), Some(1));
        }
        assert!(arrivals.sequences.len() <= MAX_PUBLISHERS);
    }
}
