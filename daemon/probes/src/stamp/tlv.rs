//! TLVs (type, length, value) after a base packet (RFC 8972, section 4).

use std::ops::Range;

use peernet_clock::RawTime;

use super::auth::{CODE_BYTES, Key};

/// Type: octets that make a packet larger.
pub const EXTRA_PADDING: u8 = 1;
/// Type: true departure of the previous reply.
pub const FOLLOW_UP: u8 = 7;
/// Type: authentication of the TLVs before it.
pub const HMAC: u8 = 8;
/// Type for private use: the mark `PEER`, then an [`Origin`].
pub const ORIGIN: u8 = 252;
/// Type for private use: the mark `PRAW`, then [`RawStamps`].
pub const RAW_STAMPS: u8 = 253;

/// Flag: the reflector does not know the type. Senders set the flag; reflectors that know the type clear it.
pub const UNRECOGNISED: u8 = 0x80;
/// Flag: the length is wrong for the type or the packet.
pub const MALFORMED: u8 = 0x40;
/// Flag: the TLVs are not intact ([`are_intact`]).
pub const NOT_INTACT: u8 = 0x20;

/// Length of the header before the value: flags, type, length. Bytes.
pub const HEADER_BYTES: usize = 4;

const ORIGIN_MARK: [u8; 4] = *b"PEER";
const RAW_MARK: [u8; 4] = *b"PRAW";

/// Header of a TLV, and its position among the bytes of all TLVs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlvHeader {
    /// Offset of the TLV's first byte, the flags.
    pub offset: usize,
    /// Flags.
    pub flags: u8,
    /// Type.
    pub kind: u8,
    /// Range of the value. The range ends at the end of the packet if the TLV claims to be longer.
    pub value: Range<usize>,
    /// `true` if the TLV claims to be longer than the packet.
    pub overruns: bool,
}

impl TlvHeader {
    /// Returns the offset at which the next TLV would start.
    pub const fn end(&self) -> usize {
        self.value.end
    }
}

/// Returns the TLV that starts at `offset`. `None` if no TLV can start there: fewer than four bytes remain, the
/// previous TLV overran, or the type is the reserved type 0, which is the padding of TWAMP-light (RFC 8762, section
/// 4.6).
pub fn header_at(tlvs: &[u8], offset: usize) -> Option<TlvHeader> {
    let [flags, kind, high, low] = *tlvs.get(offset..)?.first_chunk::<HEADER_BYTES>()?;
    if kind == 0 {
        return None;
    }
    let start = offset + HEADER_BYTES;
    let end = start + usize::from(u16::from_be_bytes([high, low]));
    Some(TlvHeader { offset, flags, kind, value: start..end.min(tlvs.len()), overruns: end > tlvs.len() })
}

/// Returns the TLVs after a base packet, in order.
pub fn headers(tlvs: &[u8]) -> impl Iterator<Item = TlvHeader> + '_ {
    std::iter::successors(header_at(tlvs, 0), |header| header_at(tlvs, header.end()))
}

/// Appends a TLV with the flags of a sender.
pub fn push(packet: &mut Vec<u8>, kind: u8, value: &[u8]) {
    let length = u16::try_from(value.len()).expect("values of a sender are small");
    // A reflector that does not know TLVs returns the flag unchanged, and the flag is then right (RFC 8972, section 4).
    packet.extend_from_slice(&[UNRECOGNISED, kind]);
    packet.extend_from_slice(&length.to_be_bytes());
    packet.extend_from_slice(value);
}

/// Method of a stamp: by software, local (RFC 8972, section 4.3).
const SOFTWARE_LOCAL: u8 = 2;

/// Value of [`FOLLOW_UP`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FollowUp {
    /// Number of the previous reply.
    pub sequence: u32,
    /// Departure of the previous reply, in the format of the reply.
    pub timestamp: u64,
}

impl FollowUp {
    /// Length of the value. Bytes.
    pub const BYTES: usize = 16;

    /// Returns the wire form of the value.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&self.sequence.to_be_bytes());
        value[4..12].copy_from_slice(&self.timestamp.to_be_bytes());
        value[12] = SOFTWARE_LOCAL;
        value
    }

    /// Reads a value. `None` if the reflector had no previous reply or the length is wrong.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let sequence = u32::from_be_bytes(*value.first_chunk()?);
        let timestamp = u64::from_be_bytes(*value[4..].first_chunk()?);
        (timestamp != 0).then_some(Self { sequence, timestamp })
    }
}

/// Value of [`ORIGIN`]: the reflector whose clock made the stamps. In a request, both fields are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// Epoch of the reflector's wall clock, [`wall_epoch`](peernet_clock::Clock::wall_epoch).
    pub epoch: u32,
    /// Random number that the reflector's process chose at its start.
    pub instance: u64,
}

impl Origin {
    /// Length of the value. Bytes.
    pub const BYTES: usize = 16;

    /// Returns the wire form of the value.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&ORIGIN_MARK);
        value[4..8].copy_from_slice(&self.epoch.to_be_bytes());
        value[8..].copy_from_slice(&self.instance.to_be_bytes());
        value
    }

    /// Reads a value. `None` if another program uses the type.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let epoch = u32::from_be_bytes(*value[4..].first_chunk()?);
        let instance = u64::from_be_bytes(*value[8..].first_chunk()?);
        value.starts_with(&ORIGIN_MARK).then_some(Self { epoch, instance })
    }
}

/// Value of [`RAW_STAMPS`]: times of the reflector's free-running clock. In a request, all times are zero; they are
/// sent nevertheless, so that the answer is not longer than the request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawStamps {
    /// Epoch of the reflector's free-running clock, [`epoch`](peernet_clock::Clock::epoch).
    pub epoch: u32,
    /// Arrival of the request; not earlier than the true arrival.
    pub received: RawTime,
    /// Departure of the reply; not later than the true departure.
    pub replied: RawTime,
    /// Number of an earlier reply, and a time that is not later than its true departure.
    pub previous: Option<(u32, RawTime)>,
}

impl RawStamps {
    /// Length of the value. Bytes.
    pub const BYTES: usize = 36;

    /// Returns the wire form of the value.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let (sequence, departure) = self.previous.unwrap_or_default();
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&RAW_MARK);
        value[4..8].copy_from_slice(&self.epoch.to_be_bytes());
        value[8..16].copy_from_slice(&self.received.nanos().to_be_bytes());
        value[16..24].copy_from_slice(&self.replied.nanos().to_be_bytes());
        value[24..28].copy_from_slice(&sequence.to_be_bytes());
        value[28..].copy_from_slice(&departure.nanos().to_be_bytes());
        value
    }

    /// Reads a value. `None` if another program uses the type.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let raw =
            |offset: usize| Some(RawTime::from_nanos(i64::from_be_bytes(*value[offset..].first_chunk()?)));
        let number = |offset: usize| Some(u32::from_be_bytes(*value[offset..].first_chunk()?));
        let previous = (number(24)?, raw(28)?);
        let stamps = Self {
            epoch: number(4)?,
            received: raw(8)?,
            replied: raw(16)?,
            // A reflector that remembers no earlier reply leaves zero.
            previous: Some(previous).filter(|(_, departure)| *departure != RawTime::default()),
        };
        value.starts_with(&RAW_MARK).then_some(stamps)
    }

    /// Returns whether a reflector has filled in the value.
    pub fn is_filled(&self) -> bool {
        self.replied != RawTime::default()
    }
}

/// Returns whether TLVs are intact (RFC 8972, section 4.8). With a key, an [`HMAC`] must follow the
/// TLVs and authenticate the TLVs and the packet's sequence number; padding alone needs no [`HMAC`]. Without a key,
/// there must be no [`HMAC`]. Only padding may follow an [`HMAC`].
pub fn are_intact(key: Option<&Key>, sequence: u32, tlvs: &[u8]) -> bool {
    let mut code = None;
    let mut needs_code = false;
    for header in headers(tlvs) {
        match header.kind {
            // The first code does not cover a second code or another TLV after it.
            HMAC if code.is_some() => return false,
            HMAC => code = Some(header),
            EXTRA_PADDING => {}
            _ if code.is_some() => return false,
            _ => needs_code = true,
        }
    }
    match (key, code) {
        (None, code) => code.is_none(),
        (Some(_), None) => !needs_code,
        (Some(key), Some(header)) => {
            key.verifies(&[&sequence.to_be_bytes(), &tlvs[..header.offset]], &tlvs[header.value])
        }
    }
}

/// Writes the code into the TLV [`HMAC`], if there is one.
pub fn authenticate(key: &Key, sequence: u32, tlvs: &mut [u8]) {
    let header = headers(tlvs).find(|header| header.kind == HMAC && header.value.len() == CODE_BYTES);
    if let Some(header) = header {
        let code = key.code(&[&sequence.to_be_bytes(), &tlvs[..header.offset]]);
        tlvs[header.value].copy_from_slice(&code);
    }
}
