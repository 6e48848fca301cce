//! The key of probes that a session brings.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A key by which a cloud and the peers that it has accepted authenticate probes. Never printed.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ProbeKey([u8; Self::BYTES]);

impl ProbeKey {
    /// Bytes of a key.
    pub const BYTES: usize = 32;

    /// The key of these bytes, which are random.
    #[must_use]
    pub const fn new(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }

    /// What it is made of.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; Self::BYTES] {
        &self.0
    }
}

impl fmt::Debug for ProbeKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ProbeKey(hidden)")
    }
}
