//! Counts missing messages by the publishers' sequence numbers. No I/O.

use std::collections::BTreeMap;
use std::sync::Arc;

/// Maximum number of publishers whose sequence numbers are kept. Anybody on the network can publish, so the memory must
/// be bounded.
const MAX_PUBLISHERS: usize = 256;

/// The latest sequence number of each publisher of a topic.
#[derive(Debug, Default)]
pub(super) struct SequenceGaps(BTreeMap<Arc<str>, i64>);

impl SequenceGaps {
    /// Records the sequence number of a message. Returns the number of messages of the same publisher that are missing
    /// before this message.
    pub(super) fn record(&mut self, publisher: &Arc<str>, sequence: i64) -> u64 {
        if self.0.len() >= MAX_PUBLISHERS && !self.0.contains_key(publisher) {
            // Afterwards at most one gap of each known publisher is not counted.
            self.0.clear();
        }
        let previous = self.0.insert(Arc::clone(publisher), sequence);
        // A lower number means that the node was restarted.
        previous
            .and_then(|previous| u64::try_from(sequence.checked_sub(previous)?.checked_sub(1)?).ok())
            .unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_messages_are_counted_for_each_publisher() {
        let mut gaps = SequenceGaps::default();
        let (left, right): (Arc<str>, Arc<str>) = (Arc::from("/left"), Arc::from("/right"));
        let mut missing = |node, sequence| gaps.record(node, sequence);
        assert_eq!(
            (missing(&left, 7), missing(&right, 100)),
            (0, 0),
            "the first message of a publisher shows no gap"
        );
        assert_eq!((missing(&left, 8), missing(&right, 104)), (0, 3));
        assert_eq!((missing(&left, 0), missing(&left, 2)), (0, 1), "the node was restarted");
    }

    #[test]
    fn publishers_take_bounded_memory() {
        let mut gaps = SequenceGaps::default();
        for number in 0..10_000 {
            gaps.record(&Arc::from(format!("/node{number}")), 1);
        }
        assert!(gaps.0.len() <= MAX_PUBLISHERS);
    }
}
