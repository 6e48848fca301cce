//! Authentication of packets: HMAC-SHA-256, truncated to 16 bytes (RFC 8762, section 4.4).

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Bytes of an authentication code in a packet.
pub const CODE_BYTES: usize = 16;

/// Fewest bytes of a key.
const MIN_KEY_BYTES: usize = 16;

/// Most bytes of a file that holds a key.
const MAX_FILE_BYTES: u64 = 4096;

/// A key that both ends share. Never printed.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

/// Why a key could not be had.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the probes' key {}: {error}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// Others than its owner could read it.
    #[error(
        "the probes' key {} is open to others (mode {mode:04o}): restrict it with chmod 0600",
        path.display()
    )]
    OpenToOthers {
        /// Which file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// It is not a key.
    #[error(
        "the probes' key {} is {what}: it takes one line of at least {} hexadecimal digits, such as \
         `openssl rand -hex 32` makes",
        path.display(),
        2 * MIN_KEY_BYTES
    )]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        what: &'static str,
    },
}

impl Key {
    /// Reads a key from a file: one line of hexadecimal digits, at least 32, readable by its owner only.
    ///
    /// # Errors
    /// When the file cannot be read, is open to others, or holds something else.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        use std::io::Read;
        use std::os::unix::fs::PermissionsExt;

        let failed = |error| KeyError::Read { path: path.to_owned(), error };
        let file = std::fs::File::open(path).map_err(failed)?;
        let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o7777;
        if mode & 0o077 != 0 {
            return Err(KeyError::OpenToOthers { path: path.to_owned(), mode });
        }
        let mut text = String::new();
        file.take(MAX_FILE_BYTES).read_to_string(&mut text).map_err(failed)?;
        let bytes =
            from_hex(text.trim()).map_err(|what| KeyError::Malformed { path: path.to_owned(), what })?;
        Ok(Self::from_bytes(&bytes))
    }

    /// The key of these bytes, whatever their number.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self(Hmac::new_from_slice(bytes).expect("a key for HMAC has any length"))
    }

    /// Random bytes for a key that nobody has yet.
    pub fn random_bytes() -> [u8; 32] {
        rand::random()
    }

    /// The authentication code of the parts, one after the other.
    pub fn code(&self, parts: &[&[u8]]) -> [u8; CODE_BYTES] {
        let mut code = [0; CODE_BYTES];
        code.copy_from_slice(&self.over(parts).finalize().into_bytes()[..CODE_BYTES]);
        code
    }

    /// Whether `code` is that of the parts; takes the same time wherever they differ.
    pub fn verifies(&self, parts: &[&[u8]], code: &[u8]) -> bool {
        code.len() == CODE_BYTES && self.over(parts).verify_truncated_left(code).is_ok()
    }

    fn over(&self, parts: &[&[u8]]) -> Hmac<Sha256> {
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
