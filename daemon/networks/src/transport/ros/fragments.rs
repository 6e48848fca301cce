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
    bytes: BytesMut,
    reserved: Reservation,
}

impl FrameFragments {
    /// Appends a fragment. Earlier fragments are dropped if they belong to another message. Returns `None` if the
    /// fragments exceed a limit; the message is then lost.
    pub(super) fn with_fragment(
        fragments: Option<Self>,
        (fragment, now): (&MessageInfo, MonoTime),
        budget: &Arc<MemoryBudget>,
        max_bytes: u64,
    ) -> Option<Self> {
        let new_fragments = || Self {
            stamp: fragment.header.stamp,
            received_at: now,
            bytes: BytesMut::new(),
            reserved: Reservation::empty(budget),
        };
        let mut fragments =
            fragments.filter(|fragments| fragments.belong_to(fragment)).unwrap_or_else(new_fragments);
        let length = (fragments.bytes.len() + fragment.frames.len()) as u64;
        if length > max_bytes || fragments.reserved.resize(budget, length).is_err() {
            return None;
        }
        fragments.bytes.extend_from_slice(&fragment.frames);
        fragments.received_at = now;
        Some(fragments)
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

    /// Returns all frames of the message. `last` are the frames of the last companion, which have the remaining bytes.
    pub(super) fn join(mut self, last: &Bytes) -> Bytes {
        self.bytes.extend_from_slice(last);
        self.bytes.freeze()
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
            fragments,
            (&fragment(1, b"def"), MonoTime::default()),
            &budget,
            10,
        )
        .expect("fits");
        assert!(fragments.belong_to(&fragment(1, b"")) && !fragments.belong_to(&fragment(2, b"")));
        assert_eq!(budget.reserved_bytes(), 6);
        assert_eq!(fragments.join(&frames), "abcdefg");
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn fragments_of_another_message_or_beyond_limit_are_dropped() {
        let budget = MemoryBudget::new(5);
        let fragments =
            FrameFragments::with_fragment(None, (&fragment(1, b"abc"), MonoTime::default()), &budget, 10);
        let fragments =
            FrameFragments::with_fragment(fragments, (&fragment(2, b"de"), MonoTime::default()), &budget, 10);
        assert_eq!(budget.reserved_bytes(), 2);
        assert!(
            FrameFragments::with_fragment(
                fragments,
                (&fragment(2, b"fghi"), MonoTime::default()),
                &budget,
                10
            )
            .is_none()
        );
        assert!(
            FrameFragments::with_fragment(None, (&fragment(3, b"abc"), MonoTime::default()), &budget, 2)
                .is_none()
        );
        assert_eq!(budget.reserved_bytes(), 0);
    }
}
