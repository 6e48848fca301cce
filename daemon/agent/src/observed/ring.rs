//! The newest stamps of an observed pipeline. No I/O.

use std::collections::{HashMap, VecDeque};

use peernet_clock::{MonoTime, Span};

use super::ObservedPair;
use crate::link::HostStamp;

/// Topic of a message: the input topic, which the observed nodes receive, or the output topic, which they publish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Input,
    Output,
}

/// Stamps of the newest messages, by key.
#[derive(Debug)]
pub(super) struct StampRing {
    capacity: usize,
    /// Time after which the same key belongs to another message, for example in a recording that is played in a loop.
    lifetime: Span,
    entries: HashMap<i64, Entry>,
    /// Keys of the entries, oldest first, without duplicates.
    keys: VecDeque<i64>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    first_received: MonoTime,
    input: Option<(HostStamp, MonoTime)>,
    output: Option<(HostStamp, MonoTime)>,
}

impl StampRing {
    pub(super) fn new(capacity: usize, lifetime: Span) -> Self {
        Self { capacity, lifetime, entries: HashMap::new(), keys: VecDeque::new() }
    }

    /// Records the stamp of a message that was received at `at`. Of several messages with one key, the first is kept,
    /// as in the pairing.
    pub(super) fn record(&mut self, side: Side, key: i64, stamp: HostStamp, at: MonoTime) {
        let new_entry = Entry { first_received: at, input: None, output: None };
        match self.entries.get(&key) {
            Some(entry) if at - entry.first_received < self.lifetime => {}
            Some(_) => {
                // The linear search is acceptable, because only a recording that is played again needs this case.
                self.keys.retain(|other| *other != key);
                self.entries.insert(key, new_entry);
                self.keys.push_back(key);
            }
            None => {
                if self.keys.len() >= self.capacity
                    && let Some(oldest) = self.keys.pop_front()
                {
                    self.entries.remove(&oldest);
                }
                self.entries.insert(key, new_entry);
                self.keys.push_back(key);
            }
        }
        if let Some(entry) = self.entries.get_mut(&key) {
            let slot = match side {
                Side::Input => &mut entry.input,
                Side::Output => &mut entry.output,
            };
            slot.get_or_insert((stamp, at));
        }
    }

    /// Returns the stamps of a key.
    pub(super) fn find(&self, key: i64) -> ObservedPair {
        let entry = self.entries.get(&key);
        let (input, output) = (entry.and_then(|entry| entry.input), entry.and_then(|entry| entry.output));
        let elapsed = input.zip(output).map(|((_, input), (_, output))| output - input);
        ObservedPair::new(key, input.map(|(stamp, _)| stamp), output.map(|(stamp, _)| stamp), elapsed)
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{RawTime, WallTime};

    use super::*;

    fn record(ring: &mut StampRing, side: Side, key: i64, millis: i64) {
        let stamp = HostStamp {
            wall: WallTime::from_unix_nanos(millis),
            raw: RawTime::from_nanos(millis),
            epoch: Some(0),
        };
        ring.record(side, key, stamp, MonoTime::from_nanos(millis * 1_000_000));
    }

    #[test]
    fn messages_of_key_are_found_in_any_order() {
        let mut ring = StampRing::new(4, Span::from_seconds(5));
        record(&mut ring, Side::Input, 1, 10);
        assert!(!ring.find(1).is_complete());
        record(&mut ring, Side::Output, 1, 40);
        assert_eq!(ring.find(1).elapsed(), Some(Span::from_millis(30)));
        record(&mut ring, Side::Output, 2, 50);
        record(&mut ring, Side::Input, 2, 51);
        assert_eq!(ring.find(2).elapsed(), Some(Span::from_millis(-1)));
        assert_eq!(ring.find(3), ObservedPair::new(3, None, None, None));
    }

    #[test]
    fn first_message_of_key_counts_until_it_expires() {
        let mut ring = StampRing::new(4, Span::from_millis(1000));
        record(&mut ring, Side::Input, 1, 10);
        record(&mut ring, Side::Input, 1, 20);
        assert_eq!(ring.find(1).input().map(|stamp| stamp.wall.unix_nanos()), Some(10));
        record(&mut ring, Side::Output, 1, 30);
        record(&mut ring, Side::Input, 1, 2000);
        let pair = ring.find(1);
        assert_eq!(pair.input().map(|stamp| stamp.wall.unix_nanos()), Some(2000));
        assert_eq!(pair.output(), None, "the earlier output does not belong to the new input");
    }

    #[test]
    fn memory_is_bounded_and_newest_stamps_stay() {
        let mut ring = StampRing::new(8, Span::from_seconds(5));
        for key in 0..10_000 {
            record(&mut ring, Side::Input, key, key);
            record(&mut ring, Side::Output, key, key + 1);
        }
        assert_eq!((ring.entries.len(), ring.keys.len()), (8, 8));
        assert!(ring.find(9_999).is_complete() && !ring.find(9_991).is_complete());
    }
}
