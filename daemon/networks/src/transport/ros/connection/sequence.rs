//! Numbers and stamps of the companions of a connection.

use peernet_ros::messages::{Header, MessageInfo, Time};

/// Largest stamp of a header that both versions of ROS can encode. Nanoseconds.
const MAX_STAMP: i64 = i32::MAX as i64 * 1_000_000_000;

/// Numbers and stamps of the companions that this end sends. The numbers have no gaps, and the stamps increase.
#[derive(Debug)]
pub(super) struct OutgoingSequence {
    /// Identifier of the connection.
    connection: String,
    next_number: u64,
    last_stamp: i64,
}

impl OutgoingSequence {
    pub(super) fn new(connection: String) -> Self {
        Self { connection, next_number: 0, last_stamp: 0 }
    }

    /// Returns the identifier of the connection.
    pub(super) fn connection(&self) -> &str {
        &self.connection
    }

    /// Returns the companion of a message that departs at `wall`, in nanoseconds since the Unix epoch.
    pub(super) fn new_companion(&mut self, kind: u8, wall: i64) -> MessageInfo {
        // Stamps increase even if the wall clock is set back, because a payload is identified by its stamp.
        let min_stamp = self.last_stamp + 1;
        self.last_stamp = if wall <= MAX_STAMP { wall.max(min_stamp) } else { min_stamp };
        let sequence = self.next_number();
        let stamp = Time::from_nanos(self.last_stamp);
        // This field of the header has only 32 bits. Receivers use the field `sequence` instead.
        let seq = u32::try_from(sequence & u64::from(u32::MAX)).unwrap_or_default();
        let header = Header { seq, stamp, frame_id: self.connection.clone() };
        MessageInfo { header, kind, sequence, request: MessageInfo::NO_REQUEST, ..MessageInfo::default() }
    }

    /// Returns a companion for a fragment of a message. The fragment takes the number of the message, and the message
    /// gets the next number, because its last companion is sent after the fragment.
    pub(super) fn new_fragment(&mut self, message: &mut MessageInfo) -> MessageInfo {
        let sequence = std::mem::replace(&mut message.sequence, self.next_number());
        MessageInfo {
            header: message.header.clone(),
            kind: MessageInfo::PART,
            sequence,
            request: message.request,
            ..MessageInfo::default()
        }
    }

    /// Takes back the numbers from `first` on, whose companions were not sent. Their stamps are not used again, because
    /// the payload of a message may have been sent without its companion.
    pub(super) fn take_back_numbers(&mut self, first: u64) {
        self.next_number = first;
    }

    fn next_number(&mut self) -> u64 {
        let number = self.next_number;
        self.next_number += 1;
        number
    }
}

/// Numbers of the companions that arrive.
#[derive(Debug, Default)]
pub(super) struct IncomingSequence {
    /// Number of the next companion; unknown before the first companion.
    next_expected: Option<u64>,
    missing: u64,
}

impl IncomingSequence {
    /// Counts the companions that are missing before the companion that arrived. Counts none if the companion that
    /// arrived has a lower number than expected; such a late companion stays counted as missing.
    pub(super) fn receive(&mut self, number: u64) {
        let next_expected = self.next_expected.unwrap_or(number);
        self.missing += number.saturating_sub(next_expected);
        // The peer chooses the number, which may be the largest possible number.
        self.next_expected = Some(number.saturating_add(1).max(next_expected));
    }

    /// Returns whether a companion was received.
    pub(super) fn has_received(&self) -> bool {
        self.next_expected.is_some()
    }

    /// Returns the number of companions that did not arrive, or not in order.
    pub(super) fn missing_companions(&self) -> u64 {
        self.missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_increase_when_wall_clock_is_set_back() {
        let mut sequence = OutgoingSequence::new("ab".into());
        let stamps = [5_000, 4_000, 4_000, i64::MIN, i64::MAX, 9_000];
        let stamps =
            stamps.map(|wall| sequence.new_companion(MessageInfo::HEARTBEAT, wall).header.stamp.as_nanos());
        assert_eq!(stamps, [5_000, 5_001, 5_002, 5_003, 5_004, 9_000]);
    }

    #[test]
    fn fragments_are_numbered_before_their_message() {
        let mut sequence = OutgoingSequence::new("ab".into());
        let mut message = MessageInfo { request: 7, ..sequence.new_companion(MessageInfo::DATA, 5) };
        let fragments = [sequence.new_fragment(&mut message), sequence.new_fragment(&mut message)];
        assert_eq!((fragments[0].sequence, fragments[1].sequence, message.sequence), (0, 1, 2));
        let is_of_message =
            |fragment: &MessageInfo| fragment.header == message.header && fragment.request == 7;
        assert!(fragments.iter().all(is_of_message));
        assert_eq!(sequence.new_companion(MessageInfo::HEARTBEAT, 5).sequence, 3);
    }

    #[test]
    fn missing_companions_are_counted() {
        let mut sequence = IncomingSequence::default();
        for number in [5, 6, 9, 7, 10] {
            sequence.receive(number);
        }
        assert_eq!(sequence.missing_companions(), 2);
        sequence.receive(u64::MAX);
        sequence.receive(0);
        assert_eq!(sequence.missing_companions(), 2 + (u64::MAX - 11));
    }
}
