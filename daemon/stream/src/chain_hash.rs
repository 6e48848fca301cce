//! Hash of a batch together with all batches before it in its stream.

use std::fmt;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// SHA-256 over the chain hash of the previous batch, the number of events and their bytes, truncated to 128 bits.
///
/// If a spool was copied (a copied machine, a restored disk) and both copies continue, their batches have the same
/// stream and numbers but different chain hashes. The comparison of one chain hash therefore detects a difference at
/// any earlier batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ChainHash(#[serde(with = "serde_bytes")] [u8; 16]);

impl ChainHash {
    /// Chain hash that precedes the first batch.
    pub const START: Self = Self([0; 16]);

    /// Returns the chain hash of the next batch, which has `events` events with the wire form `body`.
    pub fn next(self, events: u32, body: &[u8]) -> Self {
        // The only field of variable length comes last, so that different values of the fields never result in the
        // same sequence of bytes.
        // The hash covers the number of events, too, because no other hash protects the head of a batch.
        let digest = Sha256::new().chain_update(self.0).chain_update(events.to_be_bytes()).chain_update(body);
        let (chain, _) =
            digest.finalize().0.split_first_chunk().map(|(head, rest)| (*head, rest)).unwrap_or_default();
        Self(chain)
    }

    /// Returns the 16 bytes of the chain hash.
    pub const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }

    /// Creates the chain hash with the given bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }
}

impl fmt::Display for ChainHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chain_is_hash_of_all_batches_so_far() {
        // The expected value is the output of `(head -c 16 /dev/zero; printf '\0\0\0\2ab') | sha256sum`.
        let chain = ChainHash::START.next(2, b"ab");
        assert_eq!(chain.to_string(), "406eafa51a022395ef1bb1ee145156df");
        assert_eq!(ChainHash::from_bytes(*chain.as_bytes()), chain);
        let other_chains = [
            ChainHash::START.next(1, b"ab"),
            ChainHash::START.next(2, b"ac"),
            chain.next(2, b"ab"),
            ChainHash::START,
        ];
        assert!(other_chains.iter().all(|other| *other != chain));
    }
}
