//! Frames that arrive in several companions, without I/O.

use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::{MessageInfo, Time};

use crate::transport::memory::{MemoryBudget, Reservation};

/// First bytes of the frames of a message.
#[derive(Debug)]
pub(super) struct Parts {
    stamp: Time,
    /// Time at which the last part arrived.
    received_at: MonoTime,
    bytes: BytesMut,
    reserved: Reservation,
}

impl Parts {
    /// Returns the parts with one more. Parts of another message are dropped. `None` if they exceed a limit; the
    /// message is then incomplete.
    pub(super) fn extended(
        parts: Option<Self>,
        (part, now): (&MessageInfo, MonoTime),
        budget: &Arc<MemoryBudget>,
        most_bytes: u64,
    ) -> Option<Self> {
        let begin = || Self {
            stamp: part.header.stamp,
            received_at: now,
            bytes: BytesMut::new(),
            reserved: Reservation::empty(budget),
        };
        let mut parts = parts.filter(|parts| parts.is_of(part)).unwrap_or_else(begin);
        let length = (parts.bytes.len() + part.frames.len()) as u64;
        if length > most_bytes || parts.reserved.resize(budget, length).is_err() {
            return None;
        }
        parts.bytes.extend_from_slice(&part.frames);
        parts.received_at = now;
        Some(parts)
    }

    /// Returns whether nothing was added for `patience`.
    pub(super) fn is_overdue(&self, now: MonoTime, patience: Span) -> bool {
        now - self.received_at >= patience
    }

    /// Returns whether the parts belong to the message of this companion.
    pub(super) fn is_of(&self, info: &MessageInfo) -> bool {
        self.stamp == info.header.stamp
    }

    /// Returns all frames of the message. `last` has the remaining bytes.
    pub(super) fn joined(mut self, last: &Bytes) -> Bytes {
        self.bytes.extend_from_slice(last);
        self.bytes.freeze()
    }
}

/// Splits the frames of a message into pieces of `most` bytes. The remaining bytes stay in `frames`, for the companion
/// itself.
pub(super) fn split(frames: &mut Bytes, most: usize) -> Vec<Bytes> {
    let mut pieces = Vec::new();
    while frames.len() > most {
        pieces.push(frames.split_to(most));
    }
    pieces
}

#[cfg(test)]
mod tests {
    use peernet_ros::messages::Header;

    use super::*;

    fn part(stamp: i64, frames: &'static [u8]) -> MessageInfo {
        let header = Header { stamp: Time::from_nanos(stamp), ..Header::default() };
        MessageInfo { header, frames: Bytes::from_static(frames), ..MessageInfo::default() }
    }

    #[test]
    fn pieces_are_joined_as_split() {
        let mut frames = Bytes::from_static(b"abcdefg");
        let pieces = split(&mut frames, 3);
        assert_eq!((&pieces[..], &frames[..]), (&[Bytes::from("abc"), Bytes::from("def")][..], &b"g"[..]));
        let budget = MemoryBudget::new(10);
        let parts = Parts::extended(None, (&part(1, b"abc"), MonoTime::default()), &budget, 10);
        let parts =
            Parts::extended(parts, (&part(1, b"def"), MonoTime::default()), &budget, 10).expect("fits");
        assert!(parts.is_of(&part(1, b"")) && !parts.is_of(&part(2, b"")));
        assert_eq!(budget.reserved_bytes(), 6);
        assert_eq!(parts.joined(&frames), "abcdefg");
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn parts_of_another_message_or_beyond_a_bound_are_dropped() {
        let budget = MemoryBudget::new(5);
        let parts = Parts::extended(None, (&part(1, b"abc"), MonoTime::default()), &budget, 10);
        let parts = Parts::extended(parts, (&part(2, b"de"), MonoTime::default()), &budget, 10);
        assert_eq!(budget.reserved_bytes(), 2);
        assert!(Parts::extended(parts, (&part(2, b"fghi"), MonoTime::default()), &budget, 10).is_none());
        assert!(Parts::extended(None, (&part(3, b"abc"), MonoTime::default()), &budget, 2).is_none());
        assert_eq!(budget.reserved_bytes(), 0);
    }
}
