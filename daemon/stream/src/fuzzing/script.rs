//! Bytes as a list of decisions.

use peernet_clock::{ClockIdentity, WallTime};

use crate::{
    BatchHead, ChainHash, Hardware, Hello, HelloExtension, HighWaterMark, HostDescription, STREAM_VERSIONS,
    StreamId,
};
use peernet_logger::HostId;

/// Reader of decisions from bytes. After the last byte, the reader returns zeros. Several decisions may depend on one
/// number, so that scripts are short.
pub(super) struct Script<'a>(pub(super) &'a [u8]);

impl Script<'_> {
    pub(super) fn is_over(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn byte(&mut self) -> u8 {
        let Some((&byte, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        byte
    }

    pub(super) fn bytes(&mut self) -> Vec<u8> {
        let count = usize::from(self.byte()).min(self.0.len());
        let (bytes, rest) = self.0.split_at(count);
        self.0 = rest;
        bytes.to_vec()
    }

    /// Returns a number that is usually small, so that some numbers are consecutive, and otherwise near the largest
    /// value of `i64` or `u64`.
    pub(super) fn number(&mut self) -> u64 {
        match self.byte() {
            small @ 0..200 => u64::from(small % 16),
            near @ 200..228 => u64::MAX - u64::from(near - 200),
            // From 14 below the largest `i64` to 13 above it.
            near => i64::MAX as u64 + u64::from(near) - 242,
        }
    }

    pub(super) fn host(&mut self) -> HostId {
        HostId::from_bytes([self.byte() % 3; 16])
    }

    pub(super) fn stream(&mut self) -> StreamId {
        StreamId::from_bytes([self.byte() % 4; 16])
    }

    /// Returns the chain hash that belongs to `number`, so that chain hashes often agree; sometimes another chain hash.
    pub(super) fn chain(&mut self, number: u64) -> ChainHash {
        let mut bytes = [0; 16];
        let (head, tail) = bytes.split_at_mut(8);
        head.copy_from_slice(&number.to_be_bytes());
        if let other @ 224.. = self.byte() {
            tail.fill(other);
        }
        ChainHash::from_bytes(bytes)
    }

    pub(super) fn mark(&mut self, host: HostId) -> HighWaterMark {
        let stored = self.number();
        let (chain, process) = (self.chain(stored), (stored & 4 == 0).then_some(stored & 3));
        HighWaterMark { host, stored, chain, process, events: (stored & 8 == 0).then(|| self.number()) }
    }

    pub(super) fn head(&mut self) -> BatchHead {
        let (host, stream, number) = (self.host(), self.stream(), self.number());
        let (previous_chain, chain) = (self.chain(number.wrapping_sub(1)), self.chain(number));
        let events = self.byte();
        let process = u64::from(events >> 6);
        let events_before = self.number();
        BatchHead {
            host,
            stream,
            process,
            number,
            previous_chain,
            chain,
            events: events.into(),
            events_before,
        }
    }

    pub(super) fn hello(&mut self) -> Hello {
        let (id, stream, oldest) = (self.host(), self.stream(), self.number());
        let choice = self.byte();
        Hello {
            protocol: if choice == 255 { 0 } else { STREAM_VERSIONS.oldest() },
            host: host(id),
            stream,
            previous_stream: (choice & 1 != 0).then(|| self.stream()),
            first: if choice & 2 == 0 { 1 } else { self.number() },
            oldest,
            chain_before_oldest: self.chain(oldest.wrapping_sub(1)),
            events_before_oldest: self.number(),
            events_before_first: (choice & 4 == 0).then(|| self.number()),
            batch_bytes: u32::from(choice) << (choice % 25),
            process: u64::from(choice >> 6),
            extension: (choice & 8 != 0)
                .then_some(HelloExtension { newest: Some(choice.into()), since: None }),
        }
    }
}

pub(super) fn host(id: HostId) -> HostDescription {
    HostDescription {
        id,
        name: format!("host-{}", id.as_bytes()[0]).parse().expect("a name"),
        clock: ClockIdentity::new("boot", "system"),
        version: "0".into(),
        hardware: Hardware::default(),
        serves: None,
        models: Vec::new(),
    }
}

/// Returns the wall clock time at which a script begins.
pub(super) fn start_time() -> WallTime {
    WallTime::from_unix_nanos(1_800_000_000_000_000_000)
}
