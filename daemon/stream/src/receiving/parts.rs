//! Reassembly of batches that arrive in parts.

use std::collections::BTreeMap;

use bytes::Bytes;

use super::super::codec::Part;
use peernet_logger::HostId;

/// Batches with missing parts: at most one per host, with a limit on the bytes of all together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Parts {
    begun: BTreeMap<HostId, Begun>,
    bytes: u64,
    most: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Begun {
    total: u32,
    bytes: Vec<u8>,
}

impl Parts {
    pub(super) const fn new(most: u64) -> Self {
        Self { begun: BTreeMap::new(), bytes: 0, most }
    }

    /// Adds a part. Returns the frame of the batch that it completes. A part that does not follow the previous one
    /// discards the batch.
    pub(super) fn take(&mut self, part: &Part) -> Option<Bytes> {
        if part.offset == 0 {
            self.forget(part.host);
            self.begun.insert(part.host, Begun { total: part.total, bytes: Vec::new() });
        }
        let begun = self.begun.get_mut(&part.host)?;
        let follows = begun.total == part.total && begun.bytes.len() == part.offset as usize;
        if !follows || self.bytes + part.bytes.len() as u64 > self.most {
            self.forget(part.host);
            return None;
        }
        begun.bytes.extend_from_slice(&part.bytes);
        self.bytes += part.bytes.len() as u64;
        if begun.bytes.len() < begun.total as usize {
            return None;
        }
        self.forget(part.host)
    }

    /// Removes the incomplete batch of a host, and returns its bytes.
    pub(super) fn forget(&mut self, host: HostId) -> Option<Bytes> {
        let begun = self.begun.remove(&host)?;
        self.bytes -= begun.bytes.len() as u64;
        Some(begun.bytes.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(host: HostId, offset: u32, total: u32, bytes: &'static [u8]) -> Part {
        Part { host, offset, total, bytes: Bytes::from_static(bytes) }
    }

    #[test]
    fn parts_make_a_whole_whoever_else_sends_some() {
        let [one, other] = [HostId::from_bytes([1; 16]), HostId::from_bytes([2; 16])];
        let mut parts = Parts::new(100);
        assert_eq!(parts.take(&part(one, 0, 6, b"abc")), None);
        assert_eq!(parts.take(&part(other, 0, 4, b"12")), None);
        assert_eq!(parts.take(&part(one, 3, 6, b"def")).as_deref(), Some(&b"abcdef"[..]));
        assert_eq!(parts.take(&part(other, 2, 4, b"34")).as_deref(), Some(&b"1234"[..]));
        assert_eq!(parts, Parts::new(100), "nothing is kept");
    }

    #[test]
    fn what_does_not_follow_is_never_taken_for_a_whole() {
        let host = HostId::from_bytes([1; 16]);
        let mut parts = Parts::new(100);
        assert_eq!(parts.take(&part(host, 3, 6, b"def")), None, "without a beginning");
        for wrong in [part(host, 4, 6, b"ef"), part(host, 3, 7, b"def"), part(host, 2, 6, b"cdef")] {
            assert_eq!(parts.take(&part(host, 0, 6, b"abc")), None);
            assert_eq!(parts.take(&wrong), None);
            assert_eq!(parts.take(&part(host, 3, 6, b"def")), None, "it has ended");
        }
        // A batch that is sent again starts with its first part.
        parts.take(&part(host, 0, 6, b"abc"));
        parts.take(&part(host, 0, 4, b"12"));
        assert_eq!(parts.take(&part(host, 2, 4, b"34")).as_deref(), Some(&b"1234"[..]));
    }

    #[test]
    fn memory_is_bounded_whatever_is_begun() {
        let mut parts = Parts::new(100);
        for host in 0..200 {
            parts.take(&part(HostId::from_bytes([host; 16]), 0, 4_000_000, b"0123456789"));
            assert!(parts.bytes <= 100 && parts.begun.len() <= 10, "{parts:?}");
        }
    }
}
