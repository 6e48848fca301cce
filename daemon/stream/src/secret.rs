//! Host secrets, and the proof that an agent has the secret of its host id.
//!
//! The aggregator answers a hello with a challenge, and the agent answers the challenge with a proof: HMAC-SHA-256 (RFC
//! 2104) with the host's secret as the key, over the challenge's nonce and fields of the hello. A hello without a proof
//! changes nothing. The secret itself is sent only if the aggregator asks for it, because the aggregator has no secret
//! of that host (trust on first use). The event stream is not encrypted: whoever can read the network at that moment
//! can read the secret.

use std::fmt;
use std::str::FromStr;

use hmac::{Hmac, KeyInit, Mac};
use serde::{Deserialize, Serialize};
use sha2::Sha256;

use super::Hello;
use peernet_logger::Slug;

/// Domain separator: a code that is computed with the same secret for another purpose is not a valid proof.
const DOMAIN: &[u8] = b"peernet event stream: proof of a host secret\0";

/// Number of bytes of a secret, of a nonce and of a proof.
const BYTES: usize = 32;

/// Random secret stored next to the host id. With the secret, an agent proves that it is the host with this id. `Debug`
/// does not show the secret.
#[derive(Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostSecret(#[serde(with = "serde_bytes")] [u8; BYTES]);

/// Error for a text that is not a host secret.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a host secret is written as {} hexadecimal digits", 2 * BYTES)]
pub struct InvalidSecret;

/// Random number that is used once, so that a recorded proof cannot be used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Nonce(#[serde(with = "serde_bytes")] [u8; BYTES]);

/// Message authentication code. Codes are compared in constant time, so that the duration reveals nothing about the
/// valid code.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ProofCode(#[serde(with = "serde_bytes")] [u8; BYTES]);

impl HostSecret {
    /// Creates a random secret.
    pub fn random() -> Self {
        Self(rand::random())
    }

    /// Creates the secret with the given bytes.
    pub const fn from_bytes(bytes: [u8; BYTES]) -> Self {
        Self(bytes)
    }

    /// Returns the bytes. They must be stored where only the owner can read them.
    pub const fn expose_bytes(&self) -> &[u8; BYTES] {
        &self.0
    }

    /// Returns the secret as hexadecimal digits. They must be stored where only the owner can read them.
    pub fn expose_text(&self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Returns the proof that the owner of this secret sends this hello to this aggregator in answer to this nonce.
    pub fn prove(&self, nonce: &Nonce, hello: &Hello, aggregator: &Slug) -> ProofCode {
        ProofCode(self.code(nonce, hello, aggregator).finalize().into_bytes().into())
    }

    /// Returns whether a proof was made with this secret for this nonce, hello and aggregator. Takes constant time.
    pub fn verify(&self, proof: &ProofCode, nonce: &Nonce, hello: &Hello, aggregator: &Slug) -> bool {
        self.code(nonce, hello, aggregator).verify_slice(&proof.0).is_ok()
    }

    fn code(&self, nonce: &Nonce, hello: &Hello, aggregator: &Slug) -> Hmac<Sha256> {
        let mut code =
            <Hmac<Sha256> as KeyInit>::new_from_slice(&self.0).expect("HMAC takes keys of any length");
        code.update(DOMAIN);
        // The proof covers the newest version. Somebody between the ends therefore cannot lower it in the hello to
        // force an older version.
        code.update(&hello.versions().newest().to_be_bytes());
        code.update(&nonce.0);
        code.update(hello.host.id.as_bytes());
        code.update(&hello.process.to_be_bytes());
        code.update(hello.stream.as_bytes());
        // The only field of variable length comes last, so that different values of the fields never result in the
        // same sequence of bytes.
        code.update(aggregator.as_str().as_bytes());
        code
    }
}

impl fmt::Debug for HostSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("HostSecret(not shown)")
    }
}

impl PartialEq for HostSecret {
    /// Compares in constant time.
    fn eq(&self, other: &Self) -> bool {
        self.0.iter().zip(&other.0).fold(0, |different, (a, b)| different | (a ^ b)) == 0
    }
}

impl Eq for HostSecret {}

impl FromStr for HostSecret {
    type Err = InvalidSecret;

    /// Reads the format of [`expose_text`](Self::expose_text).
    fn from_str(text: &str) -> Result<Self, InvalidSecret> {
        bytes_from_hexadecimal(text).map(Self).ok_or(InvalidSecret)
    }
}

/// Reads bytes from hexadecimal digits; `None` if the text is anything else or has another number of digits.
pub fn bytes_from_hexadecimal<const COUNT: usize>(text: &str) -> Option<[u8; COUNT]> {
    let mut bytes = [0; COUNT];
    // Slicing below needs single-byte characters, and `from_str_radix` alone would accept a sign.
    if text.len() != 2 * COUNT || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * index..2 * index + 2], 16).ok()?;
    }
    Some(bytes)
}

impl Nonce {
    /// Creates a random nonce.
    pub fn random() -> Self {
        Self(rand::random())
    }

    /// Creates the nonce with the given bytes.
    pub const fn from_bytes(bytes: [u8; BYTES]) -> Self {
        Self(bytes)
    }
}

impl ProofCode {
    /// Creates the code with the given bytes.
    pub const fn from_bytes(bytes: [u8; BYTES]) -> Self {
        Self(bytes)
    }
}

impl PartialEq for ProofCode {
    /// Compares in constant time.
    fn eq(&self, other: &Self) -> bool {
        HostSecret(self.0) == HostSecret(other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::StreamId;
    use super::super::tests::hello;
    use super::*;
    use peernet_logger::HostId;

    #[test]
    fn proof_is_valid_only_for_its_nonce_hello_and_aggregator() {
        let (secret, nonce) = (HostSecret::random(), Nonce::random());
        let hello = hello(HostId::random(), "edge", 1, StreamId::random(), 1);
        let aggregator: Slug = "base".parse().expect("a name");
        let proof = secret.prove(&nonce, &hello, &aggregator);
        let is_valid = |secret: &HostSecret, nonce: &Nonce, hello: &Hello, name: &str| {
            secret.verify(&proof, nonce, hello, &name.parse().expect("a name"))
        };
        assert!(is_valid(&secret, &nonce, &hello, "base"));
        assert!(!is_valid(&HostSecret::random(), &nonce, &hello, "base"));
        assert!(!is_valid(&secret, &Nonce::random(), &hello, "base"));
        assert!(!is_valid(&secret, &nonce, &hello, "other"));
        assert!(!is_valid(&secret, &nonce, &Hello { process: 2, ..hello.clone() }, "base"));
        assert!(!is_valid(&secret, &nonce, &Hello { stream: StreamId::random(), ..hello.clone() }, "base"));
        let mut hello_of_other_host = hello;
        hello_of_other_host.host.id = HostId::random();
        assert!(!is_valid(&secret, &nonce, &hello_of_other_host, "base"));
    }

    #[test]
    fn secret_is_read_from_its_text_and_hidden_in_debug_output() {
        let secret = HostSecret::random();
        let text = secret.expose_text();
        assert_eq!(text.parse(), Ok(secret.clone()));
        assert!(!format!("{secret:?}").contains(&text[..8]));
        for wrong in ["", "ab", &text[1..], &format!("{text}0"), &format!("+{}", &text[1..])] {
            assert_eq!(wrong.parse::<HostSecret>(), Err(InvalidSecret), "{wrong}");
        }
    }
}
