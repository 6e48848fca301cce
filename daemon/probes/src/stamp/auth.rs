//! Authentication of packets: HMAC-SHA-256, truncated to 16 bytes (RFC 8762, section 4.4).

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Length of an authentication code in a packet. Bytes.
pub const CODE_BYTES: usize = 16;

/// Shortest key. Bytes.
// A shorter key would be easier to guess than the code.
const MIN_KEY_BYTES: usize = 16;

/// Largest key file. Bytes.
// The path may lead to a file without an end, such as /dev/zero.
const MAX_FILE_BYTES: u64 = 4096;

/// A key that both ends share. The `Debug` form does not show the key.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

/// Reason why a key cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the probes' key {}: {error}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// Users other than its owner can access the file.
    #[error(
        "the probes' key {} is open to others (mode {mode:04o}): restrict it with chmod 0600",
        path.display()
    )]
    OpenToOthers {
        /// Path of the file.
        path: PathBuf,
        /// Permission bits of the file.
        mode: u32,
    },
    /// The file does not contain a key.
    #[error(
        "the probes' key {} is {reason}: the file must contain one line of at least {} hexadecimal digits, as \
         `openssl rand -hex 32` prints it",
        path.display(),
        2 * MIN_KEY_BYTES
    )]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Reason, such as "too short".
        reason: &'static str,
    },
}

impl Key {
    /// Reads a key from a file: one line of at least 32 hexadecimal digits. Only the owner of the file may have access
    /// to it.
    ///
    /// # Errors
    /// If the file cannot be read, is accessible to others, or contains something else.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        use std::io::Read;
        use std::os::unix::fs::PermissionsExt;

        let read_error = |error| KeyError::Read { path: path.to_owned(), error };
        let file = std::fs::File::open(path).map_err(read_error)?;
        // The metadata is of the open file: the path may lead to another file by now.
        let mode = file.metadata().map_err(read_error)?.permissions().mode() & 0o7777;
        if mode & 0o077 != 0 {
            return Err(KeyError::OpenToOthers { path: path.to_owned(), mode });
        }
        let mut text = String::new();
        file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(read_error)?;
        if text.len() as u64 > MAX_FILE_BYTES {
            return Err(KeyError::Malformed { path: path.to_owned(), reason: "too long" });
        }
        let bytes =
            from_hex(text.trim()).map_err(|reason| KeyError::Malformed { path: path.to_owned(), reason })?;
        Ok(Self::from_bytes(&bytes))
    }

    /// Returns the key with these bytes. Any length is allowed; [`read`](Self::read) alone checks the length.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self(Hmac::new_from_slice(bytes).expect("a key for HMAC has any length"))
    }

    /// Returns random bytes for a new key.
    pub fn random_bytes() -> [u8; 32] {
        rand::random()
    }

    /// Returns the authentication code of the concatenated parts.
    pub fn code(&self, parts: &[&[u8]]) -> [u8; CODE_BYTES] {
        let mut code = [0; CODE_BYTES];
        code.copy_from_slice(&self.mac_of(parts).finalize().into_bytes()[..CODE_BYTES]);
        code
    }

    /// Returns whether `code` is the authentication code of the concatenated parts. Takes constant time.
    pub fn verifies(&self, parts: &[&[u8]], code: &[u8]) -> bool {
        // `verify_truncated_left` alone would accept a shorter code, which is easier to guess.
        code.len() == CODE_BYTES && self.mac_of(parts).verify_truncated_left(code).is_ok()
    }

    fn mac_of(&self, parts: &[&[u8]]) -> Hmac<Sha256> {
        let mut mac = self.0.clone();
        for part in parts {
            mac.update(part);
        }
        mac
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(hidden)")
    }
}

fn from_hex(text: &str) -> Result<Vec<u8>, &'static str> {
    let digits: Vec<u8> = text
        .chars()
        .map(|digit| digit.to_digit(16).and_then(|digit| u8::try_from(digit).ok()))
        .collect::<Option<_>>()
        .ok_or("not hexadecimal")?;
    if !digits.len().is_multiple_of(2) {
        return Err("of an odd number of digits");
    }
    if digits.len() < 2 * MIN_KEY_BYTES {
        return Err("too short");
    }
    Ok(digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect())
}
