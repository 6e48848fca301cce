//! A batch that is sent in parts.

use bytes::Bytes;

use super::super::codec::{self, PART_HEAD_BYTES, Part};
use peernet_logger::HostId;

/// What is left of the frame of a batch that is sent in parts.
#[derive(Clone, Debug)]
pub(super) struct PartialBatch {
    number: u64,
    frame: Bytes,
    offset: usize,
}

impl PartialBatch {
    /// All of it.
    pub(super) const fn new(number: u64, frame: Bytes) -> Self {
        Self { number, frame, offset: 0 }
    }

    /// Which batch it is.
    pub(super) const fn number(&self) -> u64 {
        self.number
    }

    /// Bytes that are left.
    pub(super) const fn len(&self) -> usize {
        self.frame.len() - self.offset
    }

    /// The next frame: no more than so many bytes of the batch, and all of it as it is where that is enough.
    pub(super) fn next(&mut self, host: HostId, most: usize) -> Vec<u8> {
        let total = self.frame.len();
        let end = total.min(self.offset + most);
        let bytes = self.frame.slice(self.offset..end);
        let offset = std::mem::replace(&mut self.offset, end);
        if bytes.len() == total {
            return bytes.into();
        }
        // A frame is far shorter than a u32 can say.
        let length = |bytes: usize| u32::try_from(bytes).unwrap_or(u32::MAX);
        codec::part_frame(&Part { host, offset: length(offset), total: length(total), bytes })
    }

    /// What a part is longer than what it carries.
    pub(super) const OVERHEAD: usize = PART_HEAD_BYTES;
}
