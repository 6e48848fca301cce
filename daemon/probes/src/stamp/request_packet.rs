//! The packet of a sender's requests, which is rewritten for each request.

use std::ops::Range;

use peernet_clock::RelatedClocks;

use super::auth::{CODE_BYTES, Key};
use super::packet::{self, Mode, Request};
use super::sender::SenderConfig;
use super::tlv::{self, FollowUp, Origin, RawStamps};

/// Random octets of one request. Its answer must return them.
pub type Nonce = [u8; NONCE_BYTES];
const NONCE_BYTES: usize = 16;

/// Packet of a request: the fields of STAMP, and empty TLVs that the reflector fills in.
#[derive(Debug)]
pub(super) struct RequestPacket {
    bytes: Vec<u8>,
    /// Position of the random octets, if requests carry them.
    nonce_range: Option<Range<usize>>,
}

impl RequestPacket {
    pub(super) fn new(config: &SenderConfig) -> Self {
        let mut bytes = vec![0; Mode::for_key(config.key.as_ref()).base_bytes()];
        tlv::push(&mut bytes, tlv::FOLLOW_UP, &[0; FollowUp::BYTES]);
        tlv::push(&mut bytes, tlv::ORIGIN, &Origin::default().to_value());
        if config.clocks == RelatedClocks::Raw {
            tlv::push(&mut bytes, tlv::RAW_STAMPS, &RawStamps::default().to_value());
        }
        // The octets are before the authentication code, so that the code covers them. The octets are padding, because
        // PEERNet reflectors of all releases return padding unchanged.
        let nonce_range = (config.with_nonce && config.key.is_some()).then(|| {
            tlv::push(&mut bytes, tlv::EXTRA_PADDING, &[0; NONCE_BYTES]);
            bytes.len() - NONCE_BYTES..bytes.len()
        });
        if config.key.is_some() {
            tlv::push(&mut bytes, tlv::HMAC, &[0; CODE_BYTES]);
        }
        // Only padding may follow the code (RFC 8972, section 4.8).
        if config.padding_bytes > 0 {
            tlv::push(&mut bytes, tlv::EXTRA_PADDING, &vec![0; usize::from(config.padding_bytes)]);
        }
        Self { bytes, nonce_range }
    }

    /// Writes and authenticates the TLVs of request `sequence`. The caller stamps the departure afterwards, so that the
    /// stamp does not include this work. Returns the octets if requests carry them.
    pub(super) fn prepare(&mut self, key: Option<&Key>, sequence: u32, octets: Nonce) -> Option<Nonce> {
        let nonce = self.nonce_range.clone().map(|range| {
            self.bytes[range].copy_from_slice(&octets);
            octets
        });
        if let Some(key) = key {
            let base = Mode::for_key(Some(key)).base_bytes();
            tlv::authenticate(key, sequence, &mut self.bytes[base..]);
        }
        nonce
    }

    /// Writes and authenticates the fields of a request. Returns the packet.
    pub(super) fn finish(&mut self, key: Option<&Key>, request: &Request) -> &[u8] {
        request.write(Mode::for_key(key), &mut self.bytes);
        if let Some(key) = key {
            packet::authenticate(key, &mut self.bytes);
        }
        &self.bytes
    }
}
