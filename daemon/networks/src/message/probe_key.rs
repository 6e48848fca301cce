//! The probe key that a cloud sends when it accepts a session.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A key with which a cloud and the peers that it has accepted authenticate probes. The `Debug` form hides the
/// bytes.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ProbeKey([u8; Self::BYTES]);

impl ProbeKey {
    /// Length of a key. Bytes.
    pub const BYTES: usize = 32;

    /// Returns the key with these random bytes.
    #[must_use]
    pub const fn new(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }

    /// Returns the bytes of the key.
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
