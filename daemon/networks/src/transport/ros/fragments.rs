//! Fragments of a message whose frames are too long for one companion (`ros2/mod.rs`). No I/O.

use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::{MessageInfo, Time};

use crate::transport::memory::{MemoryBudget, Reservation};

/// First bytes of the frames of a message, joined from the fragments that have arrived.
#[derive(Debug)]
pub(super) struct FrameFragments {
    stamp: Time,
    /// Time at which the newest fragment arrived.
    received_at: MonoTime,
    /// `None` if a fragment exceeded a limit. The message is then lost.
    bytes: Option<BytesMut>,
    reserved: Reservation,
}

impl FrameFragments {
    /// Appends a fragment. Earlier fragments are dropped if they belong to another message. If the fragments exceed a
    /// limit, their bytes are dropped and the message is lost.
    pub(super) fn with_fragment(
        fragments: Option<Self>,
        (fragment, now): (&MessageInfo, MonoTime),
        budget: &Arc<MemoryBudget>,
        max_bytes: u64,
    ) -> Self {
        let new_fragments = || Self {
            stamp: fragment.header.stamp,
            received_at: now,
            bytes: Some(BytesMut::new()),
            reserved: Reservation::empty(budget),
        };
        let mut fragments =
            fragments.filter(|fragments| fragments.belong_to(fragment)).unwrap_or_else(new_fragments);
        fragments.received_at = now;
        let Some(bytes) = &mut fragments.bytes else { return fragments };
        let length = (bytes.len() + fragment.frames.len()) as u64;
        if length > max_bytes || fragments.reserved.resize(budget, length).is_err() {
            return Self { bytes: None, reserved: Reservation::empty(budget), ..fragments };
        }
        bytes.extend_from_slice(&fragment.frames);
        fragments
    }

    /// Returns whether no fragment arrived for `time_limit`.
    pub(super) fn is_overdue(&self, now: MonoTime, time_limit: Span) -> bool {
        now - self.received_at >= time_limit
    }

    /// Returns whether the fragments belong to the message of this companion.
    pub(super) fn belong_to(&self, info: &MessageInfo) -> bool {
        // The stamps of a connection increase, so a stamp identifies one message.
        self.stamp == info.header.stamp
    }

    /// Returns all frames of the message; `None` if the message is lost. `last` are the frames of the last companion,
    /// which have the remaining bytes.
    pub(super) fn join(self, last: &Bytes) -> Option<Bytes> {
        let mut bytes = self.bytes?;
        bytes.extend_from_slice(last);
        Some(bytes.freeze())
    }
}

/// Splits the frames of a message into fragments of `max_fragment_bytes` bytes. The remaining bytes stay in `frames`,
/// for the last companion.
pub(super) fn split_into_fragments(frames: &mut Bytes, max_fragment_bytes: usize) -> Vec<Bytes> {
    let mut fragments = Vec::new();
    while frames.len() > max_fragment_bytes {
        fragments.push(frames.split_to(max_fragment_bytes));
    }
    fragments
}

#[cfg(test)]
mod tests {
    use peernet_ros::messages::Header;

    use super::*;

    fn fragment(stamp: i64, frames: &'static [u8]) -> MessageInfo {
        let header = Header { stamp: Time::from_nanos(stamp), ..Header::default() };
        MessageInfo { header, frames: Bytes::from_static(frames), ..MessageInfo::default() }
    }

    #[test]
    fn fragments_are_joined_as_split() {
        let mut frames = Bytes::from_static(b"abcdefg");
        let fragments = split_into_fragments(&mut frames, 3);
        assert_eq!((&fragments[..], &frames[..]), (&[Bytes::from("abc"), Bytes::from("def")][..], &b"g"[..]));
        let budget = MemoryBudget::new(10);
        let fragments =
            FrameFragments::with_fragment(None, (&fragment(1, b"abc"), MonoTime::default()), &budget, 10);
        let fragments = FrameFragments::with_fragment(
            Some(fragments),
            (&fragment(1, b"def"), MonoTime::default()),
            &budget,
            10,
        );
        assert!(fragments.belong_to(&fragment(1, b"")) && !fragments.belong_to(&fragment(2, b"")));
        assert_eq!(budget.reserved_bytes(), 6);
        assert_eq!(fragments.join(&frames).as_deref(), Some(&b"abcdefg"[..]));
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn fragments_of_another_message_or_beyond_limit_are_dropped() {
        let budget = MemoryBudget::new(5);
        let append = |fragments, fragment: &MessageInfo, max_bytes| {
            FrameFragments::with_fragment(fragments, (fragment, MonoTime::default()), &budget, max_bytes)
        };
        let fragments = append(None, &fragment(1, b"abc"), 10);
        let fragments = append(Some(fragments), &fragment(2, b"de"), 10);
        assert_eq!(budget.reserved_bytes(), 2);
        let mut fragments = append(Some(fragments), &fragment(2, b"fghi"), 10);
        assert_eq!(budget.reserved_bytes(), 0);
        // A later fragment of a lost message takes no memory.
        fragments = append(Some(fragments), &fragment(2, b"j"), 10);
        assert_eq!(budget.reserved_bytes(), 0);
        assert_eq!(fragments.join(&Bytes::new()), None);
        assert_eq!(append(None, &fragment(3, b"abc"), 2).join(&Bytes::new()), None);
        assert_eq!(budget.reserved_bytes(), 0);
    }
}
