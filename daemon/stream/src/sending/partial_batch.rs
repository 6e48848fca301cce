//! A batch that is sent in parts.

use bytes::Bytes;

use super::super::codec::{self, PART_HEAD_BYTES, Part};
use peernet_logger::HostId;

/// Frame of a batch that is sent in parts.
#[derive(Clone, Debug)]
pub(super) struct PartialBatch {
    number: u64,
    frame: Bytes,
    /// Number of bytes that were sent.
    offset: usize,
}

impl PartialBatch {
    /// Creates a partial batch of which nothing was sent yet.
    pub(super) const fn new(number: u64, frame: Bytes) -> Self {
        Self { number, frame, offset: 0 }
    }

    /// Returns the number of the batch.
    pub(super) const fn number(&self) -> u64 {
        self.number
    }

    /// Returns the number of remaining bytes.
    pub(super) const fn len(&self) -> usize {
        self.frame.len() - self.offset
    }

    /// Returns a frame with the next part of the batch, of at most `max_bytes` bytes; the batch's frame itself if the
    /// whole batch fits.
    pub(super) fn next(&mut self, host: HostId, max_bytes: usize) -> Vec<u8> {
        let total = self.frame.len();
        let end = total.min(self.offset + max_bytes);
        let bytes = self.frame.slice(self.offset..end);
        let offset = std::mem::replace(&mut self.offset, end);
        if bytes.len() == total {
            return bytes.into();
        }
        // A frame is far shorter than a u32 can state.
        let length = |bytes: usize| u32::try_from(bytes).unwrap_or(u32::MAX);
        codec::encode_part(&Part { host, offset: length(offset), total: length(total), bytes })
    }

    /// Number of bytes by which a part is longer than its content.
    pub(super) const OVERHEAD: usize = PART_HEAD_BYTES;
}
