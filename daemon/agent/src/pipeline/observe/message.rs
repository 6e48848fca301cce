//! A message of an observed topic, without its content.

use bytes::Bytes;
use peernet_clock::Stamp;
use peernet_ros::messages::{Field, Header, Reader, WireForm};

use crate::config::PairBy;

/// Header, length and reception time of a message of an observed topic.
#[derive(Clone, Debug)]
pub(super) struct TopicMessage {
    /// Time at which the agent received the last byte of the message.
    pub(super) received_at: Stamp,
    /// Length of the serialised message in bytes.
    pub(super) length: usize,
    /// `header.stamp` in nanoseconds since the epoch of the publisher's clock; `None` if there is no header, or the
    /// stamp is 0.
    pub(super) stamp: Option<i64>,
    /// `header.seq`: the publisher's number of the message, one more than the number of the previous message.
    pub(super) sequence: Option<i64>,
    /// Number of messages of the same publisher that are missing before this message, according to the sequence
    /// numbers.
    pub(super) missing_before: u64,
}

impl TopicMessage {
    /// Returns the key by which the message is paired, or the reason why it cannot be paired. The key is `None` if
    /// messages are paired by their order.
    pub(super) fn key(&self, pair_by: PairBy) -> Result<Option<i64>, &'static str> {
        match pair_by {
            PairBy::Stamp => self
                .stamp
                .map(Some)
                .ok_or("its header.stamp is 0 or missing; set pair_by = \"order\", which needs no stamp"),
            PairBy::Sequence => {
                self.sequence.map(Some).ok_or("it has no sequence number; choose another pair_by")
            }
            PairBy::Order => Ok(None),
        }
    }
}

/// Returns whether messages of a type begin with a `std_msgs/Header`; `definition` is the text of the type's
/// definition.
pub(super) fn begins_with_header(definition: &str) -> bool {
    let lines = definition.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
    // A line with `=` defines a constant, which is not a field.
    let first_field = lines.into_iter().find(|line| !line.is_empty() && !line.contains('='));
    let kind = first_field.and_then(|line| line.split_whitespace().next());
    // `Header` without a package and `roslib/Header` are older names of `std_msgs/Header`.
    kind.is_some_and(|kind| ["Header", "std_msgs/Header", "roslib/Header"].contains(&kind))
}

/// Reads the header at the beginning of a message; `None` if its first bytes are not a header.
pub(super) fn read_header(form: WireForm, message: &Bytes) -> Option<Header> {
    let mut reader = Reader::new(form, message.clone()).ok()?;
    // In ROS 2 the subscriber does not know the fields of a type, so it checks whether the bytes can be a header: in a
    // header's time the nanoseconds are below 1e9. In other types the number at this place is rarely below 1e9.
    Header::read(&mut reader).ok().filter(|header| header.stamp.nanosec < 1_000_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_found_behind_comments_and_constants() {
        for definition in
            ["Header header\nuint32 height\n", "# An image\n\nuint8 A=1\nstd_msgs/Header header # when"]
        {
            assert!(begins_with_header(definition), "{definition}");
        }
        for definition in ["string data\n", "", "uint32 id\nHeader header\n", "HeaderArray headers\n"] {
            assert!(!begins_with_header(definition), "{definition}");
        }
    }

    #[test]
    fn header_of_any_type_is_read() {
        // seq 7, 3 s + 5 ns, frame "a", then a field of an unknown type.
        let message = [7, 0, 0, 0, 3, 0, 0, 0, 5, 0, 0, 0, 1, 0, 0, 0, b'a', 9, 9, 9];
        let header = read_header(WireForm::Ros1, &Bytes::copy_from_slice(&message)).expect("a header");
        assert_eq!((header.seq, header.stamp.as_nanos()), (7, 3_000_000_005));
        assert!(read_header(WireForm::Ros1, &Bytes::from_static(&[1, 2])).is_none());
    }

    #[test]
    fn ros_2_message_without_header_is_recognised() {
        let header = |body: &[u8]| {
            read_header(WireForm::Cdr, &[&[0, 1, 0, 0][..], body].concat().into()).map(|header| header.stamp)
        };
        // 3 s + 5 ns, frame "a", then a field of an unknown type.
        let stamped = [3, 0, 0, 0, 5, 0, 0, 0, 2, 0, 0, 0, b'a', 0, 9, 9];
        assert_eq!(header(&stamped).map(|stamp| stamp.as_nanos()), Some(3_000_000_005));
        // A text, and the velocities 0.5, 0 and 0 m/s.
        assert_eq!(header(b"\x0b\0\0\0turn right\0\0"), None);
        let velocities: Vec<u8> = [0.5_f64, 0.0, 0.0].into_iter().flat_map(f64::to_le_bytes).collect();
        assert_eq!(header(&velocities), None);
    }
}
