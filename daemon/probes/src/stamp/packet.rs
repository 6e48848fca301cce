//! The base packets of session-sender and session-reflector in both modes (RFC 8762, sections 4.2 and 4.3, with the
//! session identifier of RFC 8972, section 3). All numbers are big-endian.

use super::auth::{CODE_BYTES, Key};
use super::timestamp::ErrorEstimate;

/// Mode of packets, which determines the offsets of their fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Unauthenticated packets.
    Unauthenticated,
    /// Packets with an authentication code at the end of the base packet.
    Authenticated,
}

/// Offsets of the fields of a base packet, without the sequence number, which is always at offset 0. Bytes.
struct Layout {
    timestamp: usize,
    estimate: usize,
    ssid: usize,
    received: usize,
    request_sequence: usize,
    request_timestamp: usize,
    request_estimate: usize,
    ttl: usize,
}

const UNAUTHENTICATED: Layout = Layout {
    timestamp: 4,
    estimate: 12,
    ssid: 14,
    received: 16,
    request_sequence: 24,
    request_timestamp: 28,
    request_estimate: 36,
    ttl: 40,
};

const AUTHENTICATED: Layout = Layout {
    timestamp: 16,
    estimate: 24,
    ssid: 26,
    received: 32,
    request_sequence: 48,
    request_timestamp: 64,
    request_estimate: 72,
    ttl: 80,
};

impl Mode {
    /// Returns the mode for an optional key.
    pub const fn for_key(key: Option<&Key>) -> Self {
        if key.is_some() { Self::Authenticated } else { Self::Unauthenticated }
    }

    /// Returns the length of the base packet, which is the same for session-sender and session-reflector. TLVs follow
    /// it.
    pub const fn base_bytes(self) -> usize {
        match self {
            Self::Unauthenticated => 44,
            Self::Authenticated => 112,
        }
    }

    const fn layout(self) -> &'static Layout {
        match self {
            Self::Unauthenticated => &UNAUTHENTICATED,
            Self::Authenticated => &AUTHENTICATED,
        }
    }
}

/// Base packet of a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Number of the packet in its session.
    pub sequence: u32,
    /// Time of departure, in the format that the error estimate names.
    pub timestamp: u64,
    /// Error estimate of the sender's stamp.
    pub estimate: ErrorEstimate,
    /// Identifier of the session; zero means no identifier.
    pub ssid: u16,
}

/// Base packet of a reflector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply {
    /// Number of the reply. A stateful reflector counts the replies of each session; a stateless reflector repeats the
    /// number of the request.
    pub sequence: u32,
    /// Time of departure, in the format that the error estimate names.
    pub timestamp: u64,
    /// Error estimate of the reflector's stamps.
    pub estimate: ErrorEstimate,
    /// Time of arrival of the request, in the format that the error estimate names.
    pub received: u64,
    /// The answered request.
    pub request: Request,
    /// Remaining hops of the request's packet; zero if unknown to the reflector.
    pub ttl: u8,
}

impl Request {
    /// Reads a request. `None` if the packet is too short.
    pub fn parse(mode: Mode, packet: &[u8]) -> Option<Self> {
        let base = packet.get(..mode.base_bytes())?;
        let layout = mode.layout();
        Some(Self {
            sequence: u32::from_be_bytes(field(base, 0)),
            timestamp: u64::from_be_bytes(field(base, layout.timestamp)),
            estimate: ErrorEstimate::from_bits(u16::from_be_bytes(field(base, layout.estimate))),
            ssid: u16::from_be_bytes(field(base, layout.ssid)),
        })
    }

    /// Writes the whole base packet without its authentication code. `packet` must be at least as long as the base
    /// packet.
    pub fn write(&self, mode: Mode, packet: &mut [u8]) {
        let base = &mut packet[..mode.base_bytes()];
        let layout = mode.layout();
        // The standards require zeros in all reserved fields.
        base.fill(0);
        put(base, 0, &self.sequence.to_be_bytes());
        put(base, layout.timestamp, &self.timestamp.to_be_bytes());
        put(base, layout.estimate, &self.estimate.bits().to_be_bytes());
        put(base, layout.ssid, &self.ssid.to_be_bytes());
    }
}

impl Reply {
    /// Reads a reply. `None` if the packet is too short. A request can also be read as a reply; the additional fields
    /// of the reply are then the bytes that follow the request.
    pub fn parse(mode: Mode, packet: &[u8]) -> Option<Self> {
        let base_fields = Request::parse(mode, packet)?;
        let layout = mode.layout();
        Some(Self {
            sequence: base_fields.sequence,
            timestamp: base_fields.timestamp,
            estimate: base_fields.estimate,
            received: u64::from_be_bytes(field(packet, layout.received)),
            request: Request {
                sequence: u32::from_be_bytes(field(packet, layout.request_sequence)),
                timestamp: u64::from_be_bytes(field(packet, layout.request_timestamp)),
                estimate: ErrorEstimate::from_bits(u16::from_be_bytes(field(
                    packet,
                    layout.request_estimate,
                ))),
                ssid: base_fields.ssid,
            },
            ttl: packet[layout.ttl],
        })
    }

    /// Writes the whole base packet without its authentication code. `packet` must be at least as long as the base
    /// packet.
    pub fn write(&self, mode: Mode, packet: &mut [u8]) {
        let base_fields = Request {
            sequence: self.sequence,
            timestamp: self.timestamp,
            estimate: self.estimate,
            // A reply repeats the session identifier of its request.
            ssid: self.request.ssid,
        };
        base_fields.write(mode, packet);
        let layout = mode.layout();
        put(packet, layout.received, &self.received.to_be_bytes());
        put(packet, layout.request_sequence, &self.request.sequence.to_be_bytes());
        put(packet, layout.request_timestamp, &self.request.timestamp.to_be_bytes());
        put(packet, layout.request_estimate, &self.request.estimate.bits().to_be_bytes());
        packet[layout.ttl] = self.ttl;
    }
}

/// Writes the code of an authenticated base packet, which covers all bytes before it.
pub fn authenticate(key: &Key, packet: &mut [u8]) {
    let code_offset = Mode::Authenticated.base_bytes() - CODE_BYTES;
    let code = key.code(&[&packet[..code_offset]]);
    put(packet, code_offset, &code);
}

/// Returns whether an authenticated base packet has the right code.
pub fn is_authentic(key: &Key, packet: &[u8]) -> bool {
    packet
        .get(..Mode::Authenticated.base_bytes())
        .and_then(|base| base.split_last_chunk::<CODE_BYTES>())
        .is_some_and(|(covered, code)| key.verifies(&[covered], code))
}

/// Returns the `N` bytes at `offset`. The caller has checked the length.
fn field<const N: usize>(packet: &[u8], offset: usize) -> [u8; N] {
    *packet[offset..].first_chunk().expect("offsets lie within the base packet")
}

fn put(packet: &mut [u8], offset: usize, bytes: &[u8]) {
    packet[offset..offset + bytes.len()].copy_from_slice(bytes);
}
