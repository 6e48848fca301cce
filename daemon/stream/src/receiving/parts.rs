//! Reassembly of batches that arrive in parts.

use std::collections::BTreeMap;

use bytes::Bytes;

use super::super::codec::Part;
use peernet_logger::HostId;

/// Batches with missing parts: at most one per host, with a limit on the sum of their bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PartAssembler {
    incomplete: BTreeMap<HostId, IncompleteBatch>,
    /// Number of bytes of all incomplete batches.
    bytes: u64,
    max_bytes: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct IncompleteBatch {
    /// Number of bytes of the whole frame.
    total: u32,
    /// Bytes that have arrived.
    bytes: Vec<u8>,
}

impl PartAssembler {
    pub(super) const fn new(max_bytes: u64) -> Self {
        Self { incomplete: BTreeMap::new(), bytes: 0, max_bytes }
    }

    /// Adds a part. Returns the frame of the batch if the part completes the batch. A part that does not follow the
    /// previous part, or that exceeds the limit on the sum of bytes, discards the batch.
    pub(super) fn add(&mut self, part: &Part) -> Option<Bytes> {
        if part.offset == 0 {
            self.remove(part.host);
            // The buffer grows with the parts that arrive. The total length is only stated by the peer.
            self.incomplete.insert(part.host, IncompleteBatch { total: part.total, bytes: Vec::new() });
        }
        let incomplete = self.incomplete.get_mut(&part.host)?;
        let is_next = incomplete.total == part.total && incomplete.bytes.len() == part.offset as usize;
        if !is_next || self.bytes + part.bytes.len() as u64 > self.max_bytes {
            self.remove(part.host);
            return None;
        }
        incomplete.bytes.extend_from_slice(&part.bytes);
        self.bytes += part.bytes.len() as u64;
        if incomplete.bytes.len() < incomplete.total as usize {
            return None;
        }
        self.remove(part.host)
    }

    /// Removes the incomplete batch of a host, and returns its bytes.
    pub(super) fn remove(&mut self, host: HostId) -> Option<Bytes> {
        let incomplete = self.incomplete.remove(&host)?;
        self.bytes -= incomplete.bytes.len() as u64;
        Some(incomplete.bytes.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(host: HostId, offset: u32, total: u32, bytes: &'static [u8]) -> Part {
        Part { host, offset, total, bytes: Bytes::from_static(bytes) }
    }

    #[test]
    fn parts_are_assembled_per_host() {
        let [one, other] = [HostId::from_bytes([1; 16]), HostId::from_bytes([2; 16])];
        let mut parts = PartAssembler::new(100);
        assert_eq!(parts.add(&part(one, 0, 6, b"abc")), None);
        assert_eq!(parts.add(&part(other, 0, 4, b"12")), None);
        assert_eq!(parts.add(&part(one, 3, 6, b"def")).as_deref(), Some(&b"abcdef"[..]));
        assert_eq!(parts.add(&part(other, 2, 4, b"34")).as_deref(), Some(&b"1234"[..]));
        assert_eq!(parts, PartAssembler::new(100), "complete batches are not kept");
    }

    #[test]
    fn part_out_of_order_discards_batch() {
        let host = HostId::from_bytes([1; 16]);
        let mut parts = PartAssembler::new(100);
        assert_eq!(parts.add(&part(host, 3, 6, b"def")), None, "the first part is missing");
        for wrong in [part(host, 4, 6, b"ef"), part(host, 3, 7, b"def"), part(host, 2, 6, b"cdef")] {
            assert_eq!(parts.add(&part(host, 0, 6, b"abc")), None);
            assert_eq!(parts.add(&wrong), None);
            assert_eq!(parts.add(&part(host, 3, 6, b"def")), None, "the batch was discarded");
        }
        // A batch that is sent again starts with its first part.
        parts.add(&part(host, 0, 6, b"abc"));
        parts.add(&part(host, 0, 4, b"12"));
        assert_eq!(parts.add(&part(host, 2, 4, b"34")).as_deref(), Some(&b"1234"[..]));
    }

    #[test]
    fn memory_of_incomplete_batches_is_bounded() {
        let mut parts = PartAssembler::new(100);
        for host in 0..200 {
            parts.add(&part(HostId::from_bytes([host; 16]), 0, 4_000_000, b"0123456789"));
            assert!(parts.bytes <= 100 && parts.incomplete.len() <= 10, "{parts:?}");
        }
    }
}
