//! Gaps between the sequence numbers of received messages.

use std::collections::BTreeMap;

use crate::ros2::{EndpointId, ReceiveCounts};

/// Sequence numbers of the publishers of a topic, from which gaps are derived.
#[derive(Debug, Default)]
pub(super) struct SequenceTracker {
    /// Sequence numbers of each publisher.
    publishers: BTreeMap<EndpointId, SequenceRange>,
}

/// Sequence numbers of one publisher.
#[derive(Debug)]
struct SequenceRange {
    /// Number of the first message that arrived.
    first: i64,
    highest: i64,
}

impl SequenceTracker {
    /// Maximum number of publishers whose numbers are stored. Every host on the network can create new publishers.
    const MAX_PUBLISHERS: usize = 1_024;

    /// Records a message. Returns how many messages are missing directly before it.
    ///
    /// No message is missing before the first message of a publisher, because a volatile subscription does not get
    /// earlier messages.
    pub(super) fn record(&mut self, writer: EndpointId, sequence: i64, counts: &mut ReceiveCounts) -> u64 {
        let Some(SequenceRange { first, highest }) = self.publishers.get_mut(&writer) else {
            if self.publishers.len() >= Self::MAX_PUBLISHERS {
                // Any publisher may be removed. It is then treated as a new publisher: a gap before its next message is
                // not counted.
                self.publishers.pop_first();
            }
            self.publishers.insert(writer, SequenceRange { first: sequence, highest: sequence });
            return 0;
        };
        if sequence <= *highest {
            counts.late += 1;
            // A message above the first number was counted as lost when a later message arrived. No message below the
            // first number was counted as lost.
            if sequence > *first {
                counts.lost = counts.lost.saturating_sub(1);
            }
            return 0;
        }
        let missing = u64::try_from(sequence.saturating_sub(*highest).saturating_sub(1)).unwrap_or(0);
        *highest = sequence;
        counts.lost = counts.lost.saturating_add(missing);
        missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_per_publisher() {
        let (a, b) = (EndpointId([1; 16]), EndpointId([2; 16]));
        let (mut tracker, mut counts) = (SequenceTracker::default(), ReceiveCounts::default());
        let mut record = |writer, sequence| tracker.record(writer, sequence, &mut counts);
        assert_eq!(record(a, 7), 0, "no message is missing before the first message");
        assert_eq!(record(b, 1), 0);
        assert_eq!(record(a, 8), 0);
        assert_eq!(record(a, 12), 3);
        assert_eq!(record(b, 2), 0);
        assert_eq!(record(a, 10), 0, "a late message is not lost");
        assert_eq!(record(a, 13), 0);
        assert_eq!((counts.lost, counts.late), (2, 1));
    }

    #[test]
    fn message_older_than_first_reduces_no_loss() {
        let (a, b) = (EndpointId([1; 16]), EndpointId([2; 16]));
        let (mut tracker, mut counts) = (SequenceTracker::default(), ReceiveCounts::default());
        for (writer, sequence) in [(a, 1), (a, 3), (b, 8), (b, 7)] {
            tracker.record(writer, sequence, &mut counts);
        }
        assert_eq!((counts.lost, counts.late), (1, 1));
    }

    #[test]
    fn hostile_numbers_do_not_overflow() {
        let (mut tracker, mut counts) = (SequenceTracker::default(), ReceiveCounts::default());
        tracker.record(EndpointId([1; 16]), i64::MIN, &mut counts);
        tracker.record(EndpointId([1; 16]), i64::MAX, &mut counts);
        // These 2,048 publishers are more than the tracker stores.
        for writer in 0..=u8::MAX {
            for other in 0..8 {
                let mut id = [writer; 16];
                id[0] = other;
                tracker.record(EndpointId(id), 1, &mut counts);
            }
        }
        assert!(tracker.publishers.len() <= SequenceTracker::MAX_PUBLISHERS);
    }
}
