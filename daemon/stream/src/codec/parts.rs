//! Parts of a batch's frame, for links on which the whole frame would take long.
//!
//! | bytes | content |
//! | --- | --- |
//! | 1, 1 | `0xC1`, 2 |
//! | 16 | host |
//! | 4, 4 | number of bytes of the batch's frame before this part, and of the whole frame; big-endian |
//! | rest | the part |

use bytes::{Buf, Bytes};

use super::{FRAME_MARKER, MAX_MESSAGE_BYTES, PART};
use peernet_logger::HostId;

/// Number of bytes of a part before its content.
pub(in super::super) const PART_HEAD_BYTES: usize = 2 + 16 + 4 + 4;

/// A part of a batch's frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Host that sends the batch.
    pub host: HostId,
    /// Number of bytes of the frame before this part.
    pub offset: u32,
    /// Number of bytes of the whole frame: at most [`MAX_MESSAGE_BYTES`], and at least the end of this part.
    pub total: u32,
    /// Content of the part; not empty.
    pub bytes: Bytes,
}

/// Returns the frame of a part.
pub fn encode_part(part: &Part) -> Vec<u8> {
    let mut frame = Vec::with_capacity(PART_HEAD_BYTES + part.bytes.len());
    frame.extend([FRAME_MARKER, PART]);
    frame.extend(part.host.as_bytes());
    frame.extend(part.offset.to_be_bytes());
    frame.extend(part.total.to_be_bytes());
    frame.extend(&part.bytes);
    frame
}

/// Returns the part in a frame; `None` for any other message, and for a part whose fields contradict each other.
pub fn decode_part(frame: &Bytes) -> Option<Part> {
    let rest = frame.strip_prefix(&[FRAME_MARKER, PART])?;
    let (&host, rest) = rest.split_first_chunk()?;
    let (&offset, rest) = rest.split_first_chunk()?;
    let (&total, _) = rest.split_first_chunk()?;
    let (offset, total) = (u32::from_be_bytes(offset), u32::from_be_bytes(total));
    let mut bytes = frame.clone();
    bytes.advance(PART_HEAD_BYTES);
    // The fields come from an untrusted peer.
    let end = (offset as usize).checked_add(bytes.len())?;
    let is_valid = !bytes.is_empty() && end <= total as usize && total as usize <= MAX_MESSAGE_BYTES;
    is_valid.then_some(Part { host: HostId::from_bytes(host), offset, total, bytes })
}

#[cfg(test)]
mod tests {
    use super::super::decode_batch_head;
    use super::*;

    #[test]
    fn part_is_decoded_as_encoded_and_not_as_batch() {
        let host = HostId::from_bytes([7; 16]);
        let written = Part { host, offset: 300, total: 303, bytes: Bytes::from_static(b"end") };
        let frame = Bytes::from(encode_part(&written));
        assert_eq!(frame.len(), PART_HEAD_BYTES + 3);
        assert_eq!(decode_part(&frame), Some(written.clone()));
        // The zeros make the frame long enough for the head of a batch.
        assert_eq!(decode_batch_head(&[&frame[..], &[0; 200]].concat()), None);
        assert_eq!(decode_part(&frame.slice(..PART_HEAD_BYTES)), None, "a part without content is invalid");
        let beyond_end = Part { offset: 301, ..written.clone() };
        assert_eq!(decode_part(&encode_part(&beyond_end).into()), None, "a part ends within its frame");
        let huge = Part { total: MAX_MESSAGE_BYTES as u32 + 1, ..written };
        assert_eq!(
            decode_part(&encode_part(&huge).into()),
            None,
            "a frame is not longer than the longest message"
        );
    }
}
