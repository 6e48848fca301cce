//! What may follow a base packet: type, length, value (RFC 8972, section 4).

use std::ops::Range;

use peernet_clock::RawTime;

use super::auth::{CODE_BYTES, Key};

/// Octets to make a packet larger.
pub const EXTRA_PADDING: u8 = 1;
/// When the previous reply really left.
pub const FOLLOW_UP: u8 = 7;
/// Authenticates the TLVs before it.
pub const HMAC: u8 = 8;
/// Ours, of the range for private use: the mark `PEER`, then an [`Origin`].
pub const ORIGIN: u8 = 252;
/// Ours, of the range for private use: the mark `PRAW`, then [`RawStamps`].
pub const RAW_STAMPS: u8 = 253;

/// Flag: the reflector does not know the type. Senders set it, reflectors that know the type clear it.
pub const UNRECOGNISED: u8 = 0x80;
/// Flag: the length is wrong for the type or the packet.
pub const MALFORMED: u8 = 0x40;
/// Flag: the TLVs are not authenticated.
pub const NOT_INTACT: u8 = 0x20;

/// Bytes before the value: flags, type, length.
pub const HEADER_BYTES: usize = 4;

const ORIGIN_MARK: [u8; 4] = *b"PEER";
const RAW_MARK: [u8; 4] = *b"PRAW";

/// Where a TLV stands among others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Of its first byte, the flags.
    pub at: usize,
    /// Its flags.
    pub flags: u8,
    /// Its type.
    pub kind: u8,
    /// Of its value; cut at the end of the packet if it claims more.
    pub value: Range<usize>,
    /// It claims to be longer than the packet.
    pub overruns: bool,
}

impl Place {
    /// Where the next TLV begins, if there is one.
    pub const fn end(&self) -> usize {
        self.value.end
    }
}

/// The TLV that begins at `at`. None where no further one can: at fewer than four bytes, after one that overruns, and
/// at the reserved type 0, which is the padding of TWAMP-light (RFC 8762, section 4.6).
pub fn place_at(tlvs: &[u8], at: usize) -> Option<Place> {
    let [flags, kind, high, low] = *tlvs.get(at..)?.first_chunk::<HEADER_BYTES>()?;
    if kind == 0 {
        return None;
    }
    let begin = at + HEADER_BYTES;
    let end = begin + usize::from(u16::from_be_bytes([high, low]));
    Some(Place { at, flags, kind, value: begin..end.min(tlvs.len()), overruns: end > tlvs.len() })
}

/// The TLVs after a base packet, in order.
pub fn places(tlvs: &[u8]) -> impl Iterator<Item = Place> + '_ {
    std::iter::successors(place_at(tlvs, 0), |last| place_at(tlvs, last.end()))
}

/// Appends a TLV as a sender does.
pub fn push(packet: &mut Vec<u8>, kind: u8, value: &[u8]) {
    let length = u16::try_from(value.len()).expect("values of a sender are small");
    packet.extend_from_slice(&[UNRECOGNISED, kind]);
    packet.extend_from_slice(&length.to_be_bytes());
    packet.extend_from_slice(value);
}

/// How a stamp was made (RFC 8972, section 4.3).
const SOFTWARE_LOCAL: u8 = 2;

/// The value of [`FOLLOW_UP`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FollowUp {
    /// The previous reply's number.
    pub sequence: u32,
    /// When it left, in the reply's format.
    pub timestamp: u64,
}

impl FollowUp {
    /// Bytes of the value.
    pub const BYTES: usize = 16;

    /// The value as it travels.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&self.sequence.to_be_bytes());
        value[4..12].copy_from_slice(&self.timestamp.to_be_bytes());
        value[12] = SOFTWARE_LOCAL;
        value
    }

    /// From a value; `None` where the reflector had nothing to tell or the length is wrong.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let sequence = u32::from_be_bytes(*value.first_chunk()?);
        let timestamp = u64::from_be_bytes(*value[4..].first_chunk()?);
        (timestamp != 0).then_some(Self { sequence, timestamp })
    }
}

/// The value of [`ORIGIN`]: whose clock the stamps are of. A request has the room for it, with zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The reflector's [`epoch`](peernet_clock::Clock::epoch).
    pub epoch: u32,
    /// The number that the reflector's process chose at random when it began.
    pub instance: u64,
}

impl Origin {
    /// Bytes of the value.
    pub const BYTES: usize = 16;

    /// The value as it travels.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&ORIGIN_MARK);
        value[4..8].copy_from_slice(&self.epoch.to_be_bytes());
        value[8..].copy_from_slice(&self.instance.to_be_bytes());
        value
    }

    /// From a value; `None` where somebody else uses the type.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let epoch = u32::from_be_bytes(*value[4..].first_chunk()?);
        let instance = u64::from_be_bytes(*value[8..].first_chunk()?);
        value.starts_with(&ORIGIN_MARK).then_some(Self { epoch, instance })
    }
}

/// The value of [`RAW_STAMPS`]: when the reflector's free-running clock showed what. A request has the room for it, with zeros, so that
/// the answer is no longer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawStamps {
    /// The reflector's [`epoch`](peernet_clock::Clock::epoch).
    pub epoch: u32,
    /// Not earlier than the request arrived.
    pub received: RawTime,
    /// Not later than the reply left.
    pub replied: RawTime,
    /// Number of an earlier reply, and a time not later than it left.
    pub previous: Option<(u32, RawTime)>,
}

impl RawStamps {
    /// Bytes of the value.
    pub const BYTES: usize = 36;

    /// The value as it travels.
    pub fn to_value(self) -> [u8; Self::BYTES] {
        let (sequence, left) = self.previous.unwrap_or_default();
        let mut value = [0; Self::BYTES];
        value[..4].copy_from_slice(&RAW_MARK);
        value[4..8].copy_from_slice(&self.epoch.to_be_bytes());
        value[8..16].copy_from_slice(&self.received.nanos().to_be_bytes());
        value[16..24].copy_from_slice(&self.replied.nanos().to_be_bytes());
        value[24..28].copy_from_slice(&sequence.to_be_bytes());
        value[28..].copy_from_slice(&left.nanos().to_be_bytes());
        value
    }

    /// From a value; `None` where somebody else uses the type.
    pub fn from_value(value: &[u8]) -> Option<Self> {
        let value: &[u8; Self::BYTES] = value.try_into().ok()?;
        let raw = |at: usize| Some(RawTime::from_nanos(i64::from_be_bytes(*value[at..].first_chunk()?)));
        let number = |at: usize| Some(u32::from_be_bytes(*value[at..].first_chunk()?));
        let previous = (number(24)?, raw(28)?);
        let stamps = Self {
            epoch: number(4)?,
            received: raw(8)?,
            replied: raw(16)?,
            // Zero is what a reflector leaves that remembers no earlier reply.
            previous: Some(previous).filter(|(_, left)| *left != RawTime::default()),
        };
        value.starts_with(&RAW_MARK).then_some(stamps)
    }

    /// Whether a reflector has filled it in.
    pub fn is_filled(&self) -> bool {
        self.replied != RawTime::default()
    }
}

/// Whether TLVs may be believed (RFC 8972, section 4.8): with a key, those before an [`HMAC`] that authenticates them
/// and the packet's sequence number; without one, those that claim no authentication. Nothing but padding may follow
/// an [`HMAC`], and padding alone needs none.
pub fn are_intact(key: Option<&Key>, sequence: u32, tlvs: &[u8]) -> bool {
    let mut code = None;
    let mut bare = false;
    for place in places(tlvs) {
        match place.kind {
            HMAC if code.is_some() => return false,
            HMAC => code = Some(place),
            EXTRA_PADDING => {}
            _ if code.is_some() => return false,
            _ => bare = true,
        }
    }
    match (key, code) {
        (None, code) => code.is_none(),
        (Some(_), None) => !bare,
        (Some(key), Some(place)) => {
            key.verifies(&[&sequence.to_be_bytes(), &tlvs[..place.at]], &tlvs[place.value])
        }
    }
}

/// Writes the code into the TLV [`HMAC`], where there is one.
pub fn seal(key: &Key, sequence: u32, tlvs: &mut [u8]) {
    let place = places(tlvs).find(|place| place.kind == HMAC && place.value.len() == CODE_BYTES);
    if let Some(place) = place {
        let code = key.code(&[&sequence.to_be_bytes(), &tlvs[..place.at]]);
        tlvs[place.value].copy_from_slice(&code);
    }
}
