//! Frames that arrive in several companions, without I/O.

use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::{MessageInfo, Time};

use crate::transport::memory::{MemoryBudget, Reservation};

/// First bytes of the frames of a message.
#[derive(Debug)]
pub(super) struct PartialFrames {
    stamp: Time,
    /// Time at which the last part arrived.
    received_at: MonoTime,
    bytes: BytesMut,
    reserved: Reservation,
}

impl PartialFrames {
    /// Returns the parts with one more. Parts of another message are dropped. `None` if they exceed a limit; the
    /// message is then incomplete.
    pub(super) fn with_part(
        parts: Option<Self>,
        (part, now): (&MessageInfo, MonoTime),
        budget: &Arc<MemoryBudget>,
        max_bytes: u64,
    ) -> Option<Self> {
        let begin = || Self {
            stamp: part.header.stamp,
            received_at: now,
            bytes: BytesMut::new(),
            reserved: Reservation::empty(budget),
        };
        let mut parts = parts.filter(|parts| parts.belong_to(part)).unwrap_or_else(begin);
        let length = (parts.bytes.len() + part.frames.len()) as u64;
        if length > max_bytes || parts.reserved.resize(budget, length).is_err() {
            return None;
        }
        parts.bytes.extend_from_slice(&part.frames);
        parts.received_at = now;
        Some(parts)
    }

    /// Returns whether nothing was added for `time_limit`.
    pub(super) fn is_overdue(&self, now: MonoTime, time_limit: Span) -> bool {
        now - self.received_at >= time_limit
    }

    /// Returns whether the parts belong to the message of this companion.
    pub(super) fn belong_to(&self, info: &MessageInfo) -> bool {
        self.stamp == info.header.stamp
    }

    /// Returns all frames of the message. `last` has the remaining bytes.
    pub(super) fn join(mut self, last: &Bytes) -> Bytes {
        self.bytes.extend_from_slice(last);
        self.bytes.freeze()
    }
}

/// Splits the frames of a message into pieces of `max_piece_bytes` bytes. The remaining bytes stay in `frames`, for the companion
/// itself.
pub(super) fn split_frames(frames: &mut Bytes, max_piece_bytes: usize) -> Vec<Bytes> {
    let mut pieces = Vec::new();
    while frames.len() > max_piece_bytes {
        pieces.push(frames.split_to(max_piece_bytes));
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
        let pieces = split_frames(&mut frames, 3);
        assert_eq!((&pieces[..], &frames[..]), (&[Bytes::from("abc"), Bytes::from("def")][..], &b"g"[..]));
        let budget = MemoryBudget::new(10);
        let parts = PartialFrames::with_part(None, (&part(1, b"abc"), MonoTime::default()), &budget, 10);
        let parts = PartialFrames::with_part(parts, (&part(1, b"def"), MonoTime::default()), &budget, 10)
            .expect("fits");
        assert!(parts.belong_to(&part(1, b"")) && !parts.belong_to(&part(2, b"")));
        assert_eq!(budget.reserved_bytes(), 6);
        assert_eq!(parts.join(&frames), "abcdefg");
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn parts_of_another_message_or_beyond_a_bound_are_dropped() {
        let budget = MemoryBudget::new(5);
        let parts = PartialFrames::with_part(None, (&part(1, b"abc"), MonoTime::default()), &budget, 10);
        let parts = PartialFrames::with_part(parts, (&part(2, b"de"), MonoTime::default()), &budget, 10);
        assert_eq!(budget.reserved_bytes(), 2);
        assert!(
            PartialFrames::with_part(parts, (&part(2, b"fghi"), MonoTime::default()), &budget, 10).is_none()
        );
        assert!(
            PartialFrames::with_part(None, (&part(3, b"abc"), MonoTime::default()), &budget, 2).is_none()
        );
        assert_eq!(budget.reserved_bytes(), 0);
    }
}
