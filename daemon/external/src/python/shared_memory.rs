//! Memory that is shared with the worker, for large parts.
//!
//! A pipe copies through the kernel page by page, which takes 22 µs for 150 kB on the reference machine; two `memcpy`
//! take 3 µs. Neither side writes while the other one reads: a call is a request followed by a reply, and
//! each side copies the received parts out of the memory before it sends its next message. This second copy is needed
//! because the next call overwrites the memory, and custom code may keep a value longer.

use std::fs::File;
use std::io;
use std::ptr;
use std::sync::Arc;

use bytes::Bytes;
use memmap2::MmapRaw;
use peernet_sample::Part;
use rustix::fs::{FallocateFlags, MemfdFlags, SealFlags, fallocate, fcntl_add_seals, memfd_create};
use rustix::io::Errno;

/// Shortest part that is passed in shared memory, bytes: one page. Shorter parts follow the header in the pipe.
const MIN_SHARED_BYTES: usize = 4 << 10;
/// Alignment of each part, bytes: a cache line.
const ALIGNMENT: usize = 64;
/// Initial size, bytes.
const INITIAL_SIZE_BYTES: usize = 1 << 20;
/// Memory that stays allocated between calls, bytes. Memory beyond it is returned to the system after a call.
const MAX_KEPT_BYTES: u64 = 64 << 20;

/// Shared memory, as mapped in PEERNet's process.
#[derive(Debug)]
pub(super) struct SharedMemory {
    file: Arc<File>,
    map: MmapRaw,
}

impl SharedMemory {
    /// Creates the memory, sealed so that it can grow but not shrink.
    // If one side shortened the file, the other side would be killed (SIGBUS) while it reads.
    pub(super) fn new() -> io::Result<Self> {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let create = |flags| memfd_create(c"peernet-shared-memory", flags);
        let file = match create(flags | MemfdFlags::NOEXEC_SEAL) {
            // Linux before 6.3 does not know the flag. Newer systems may require it.
            Err(Errno::INVAL) => create(flags)?,
            file => file?,
        };
        // `SEAL` forbids further seals, with which the other side could prevent growing or writing.
        fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::SEAL)?;
        let file = File::from(file);
        file.set_len(INITIAL_SIZE_BYTES as u64)?;
        Ok(Self { map: MmapRaw::map_raw(&file)?, file: Arc::new(file) })
    }

    /// Returns the file that the other process inherits.
    pub(super) fn file(&self) -> Arc<File> {
        Arc::clone(&self.file)
    }

    /// Copies the parts that are large enough into the memory. Returns the position of each; `None` for a short part.
    pub(super) fn write_parts(&mut self, parts: &[Part]) -> io::Result<Vec<Option<u64>>> {
        let mut end = 0_usize;
        let positions: Vec<_> = parts
            .iter()
            .map(|part| {
                (part.bytes.len() >= MIN_SHARED_BYTES).then(|| {
                    let at = end.next_multiple_of(ALIGNMENT);
                    end = at + part.bytes.len();
                    at
                })
            })
            .collect();
        if end > self.map.len() {
            // The other side may have extended the file for a reply that it did not finish.
            if (end as u64) > self.file.metadata()?.len() {
                // The size is rounded up, so that parts of slowly growing size do not need a new mapping for each call.
                self.file.set_len(end.next_power_of_two() as u64)?;
            }
            self.map = MmapRaw::map_raw(&*self.file)?;
        }
        for (part, at) in parts.iter().zip(&positions) {
            let Some(at) = *at else { continue };
            #[expect(unsafe_code, reason = "no slice may refer to memory that another process may write to")]
            // SAFETY: `at + len <= end <= map.len()`; no other code of this process has a pointer into the map.
            unsafe {
                ptr::copy_nonoverlapping(
                    part.bytes.as_ptr(),
                    self.map.as_mut_ptr().add(at),
                    part.bytes.len(),
                );
            }
        }
        Ok(positions.into_iter().map(|at| at.map(|at| at as u64)).collect())
    }

    /// Copies bytes out of the memory; returns `None` if they are not within it.
    pub(super) fn read_part(&mut self, at: u64, length: usize) -> io::Result<Option<Bytes>> {
        let with_end = |at: usize| Some((at, at.checked_add(length)?));
        let Some((at, end)) = usize::try_from(at).ok().and_then(with_end) else { return Ok(None) };
        if end > self.map.len() && end as u64 <= self.file.metadata()?.len() {
            // The other side extended the file.
            self.map = MmapRaw::map_raw(&*self.file)?;
        }
        if end > self.map.len() {
            return Ok(None);
        }
        let mut bytes: Vec<u8> = Vec::with_capacity(length);
        #[expect(unsafe_code, reason = "no slice may refer to memory that another process may write to")]
        // SAFETY: `at + length <= map.len()`, and the file can only grow. All mapped bytes are initialised.
        unsafe {
            ptr::copy_nonoverlapping(self.map.as_ptr().add(at), bytes.as_mut_ptr(), length);
            bytes.set_len(length);
        }
        Ok(Some(bytes.into()))
    }

    /// Returns memory beyond `MAX_KEPT_BYTES` to the system. Must not be called while a call of the Python process is
    /// in progress.
    pub(super) fn release_excess(&self) {
        let length = self.map.len() as u64;
        if length > MAX_KEPT_BYTES {
            let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
            if let Err(error) = fallocate(&*self.file, hole, MAX_KEPT_BYTES, length - MAX_KEPT_BYTES) {
                tracing::debug!(%error, "cannot release excess shared memory");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{FileExt, MetadataExt};

    use peernet_sample::Description;

    use super::*;

    fn part(length: usize) -> Part {
        let content: Vec<u8> = (0..length).map(|at| (at % 251) as u8).collect();
        Part { description: Description::bytes(), bytes: content.into() }
    }

    #[test]
    fn only_large_parts_get_shared_memory() {
        let mut shared_memory = SharedMemory::new().expect("there is memory");
        let parts = [part(5000), part(10), part(3 << 20), part(MIN_SHARED_BYTES)];
        let positions = shared_memory.write_parts(&parts).expect("there is memory");
        assert_eq!(positions[1], None);
        for (part, at) in parts.iter().zip(&positions) {
            let Some(at) = *at else { continue };
            assert_eq!(at % ALIGNMENT as u64, 0);
            assert_eq!(
                shared_memory.read_part(at, part.bytes.len()).expect("it is mapped"),
                Some(part.bytes.clone())
            );
        }
    }

    #[test]
    fn positions_outside_memory_are_refused() {
        let mut shared_memory = SharedMemory::new().expect("there is memory");
        for (at, length) in
            [(0, INITIAL_SIZE_BYTES + 1), (INITIAL_SIZE_BYTES as u64, 1), (u64::MAX, 1), (1, usize::MAX)]
        {
            assert_eq!(
                shared_memory.read_part(at, length).expect("the mapping succeeds"),
                None,
                "{length} at {at}"
            );
        }
    }

    #[test]
    fn other_side_may_grow_but_not_shrink_memory() {
        let mut shared_memory = SharedMemory::new().expect("there is memory");
        let peer_file = shared_memory.file();
        peer_file.set_len(0).expect_err("it is sealed");
        peer_file.set_len(2 * INITIAL_SIZE_BYTES as u64).expect("it may grow");
        peer_file.write_all_at(b"late", INITIAL_SIZE_BYTES as u64 + 7).expect("there is room");
        let bytes = shared_memory.read_part(INITIAL_SIZE_BYTES as u64 + 7, 4).expect("it is mapped");
        assert_eq!(bytes.as_deref(), Some(&b"late"[..]));
        peer_file.set_len(16 * INITIAL_SIZE_BYTES as u64).expect("it may grow");
        shared_memory
            .write_parts(&[part(3 * INITIAL_SIZE_BYTES)])
            .expect("the memory is large enough already");
    }

    #[test]
    fn excess_memory_is_returned_after_large_call() {
        let mut shared_memory = SharedMemory::new().expect("there is memory");
        shared_memory.write_parts(&[part(2 * MAX_KEPT_BYTES as usize)]).expect("there is memory");
        let allocated_bytes = || shared_memory.file.metadata().expect("it is open").blocks() * 512;
        assert!(allocated_bytes() >= 2 * MAX_KEPT_BYTES);
        shared_memory.release_excess();
        assert!(allocated_bytes() <= MAX_KEPT_BYTES);
    }
}
