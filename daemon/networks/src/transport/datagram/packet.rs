//! The bodies of datagrams: fixed layouts, integers in network byte order.
//!
//! The first byte is the kind; its highest bit is set in what a cloud sends, so that a datagram that is sent back to
//! where it came from means nothing there. Nonces and connections are random 64-bit numbers.
//!
//! | kind | from | fields |
//! | --- | --- | --- |
//! | 1 hello | edge | version 8, nonce 64, reply port 16, zeros up to 64 bytes |
//! | 2 cookie | cloud | nonce 64, cookie 128 |
//! | 3 open | edge | nonce 64, cookie 128, reply port 16, window 32, datagram 16, zeros up to a datagram |
//! | 4 opened | cloud | nonce 64, connection 64, window 32, datagram 16, zeros up to a datagram |
//! | 5 data | both | connection 64, number 32, sequence 64, tag 64, offset 32, total 32, checksum 32, stride 16, lifetime 16, bytes |
//! | 6 progress | both | connection 64, sequence 64, end 32 |
//! | 7 lost | both | connection 64, sequence 64, received 32, total 32 |
//! | 8 lost-known | both | connection 64, sequence 64, tag 64, total 32 |
//! | 9 ping, 10 pong | both | connection 64, time 64, next sequence 64, settled sequence 64, next number 32, lost 64, duplicated 64, reordered 64 |
//! | 11 bye | both | connection 64, next sequence 64 |
//! | 12 bye-heard | both | connection 64 |
//! | 13 path, 14 path-confirmed | both | connection 64, token 64 |
//! | 15 reset | cloud | connection or nonce 64, reason 8 |

use super::counting::ArrivalTotals;

/// The version of this layout.
pub(crate) const VERSION: u8 = 1;

/// Bytes of a hello: more than the cookie that answers it.
pub(crate) const HELLO_BYTES: usize = 64;

/// Bytes of a data packet before the fragment's bytes.
pub(crate) const DATA_HEADER_BYTES: usize = 1 + 8 + 4 + 8 + 8 + 4 + 4 + 4 + 2 + 2;

/// The bit of the kind that is set in what a cloud sends.
const FROM_CLOUD: u8 = 0x80;

/// A cookie, which proves that an address receives what is sent to it.
pub(crate) type Cookie = [u8; 16];

/// The two ends of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// The end that opens connections.
    Edge,
    /// The end that accepts them.
    Cloud,
}

/// What an end of a connection takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Terms {
    /// Bytes that may be on their way to it.
    pub(crate) window: u32,
    /// Largest datagram that is sent to it. Bytes.
    pub(crate) datagram: u16,
}

/// A part of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fragment<'a> {
    /// Number of the message in its connection and direction.
    pub(crate) sequence: u64,
    /// The sender's own number for the message, plus one; 0 for none.
    pub(crate) tag: u64,
    /// Where the bytes belong in the message; a multiple of the stride.
    pub(crate) offset: u32,
    /// Bytes of the whole message.
    pub(crate) total: u32,
    /// CRC-32 of the whole message.
    pub(crate) checksum: u32,
    /// Bytes of every fragment but the last.
    pub(crate) stride: u16,
    /// Milliseconds after which the message is of no use; 0 for none.
    pub(crate) lifetime_ms: u16,
    /// The bytes.
    pub(crate) bytes: &'a [u8],
}

/// A sign of life: how far an end has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SignOfLife {
    /// When the ping left, on its sender's clock; nanoseconds. A pong repeats it.
    pub(crate) time: u64,
    /// Messages with a lower number have left this end.
    pub(crate) next: u64,
    /// Messages of the other end with a lower number are settled here.
    pub(crate) settled: u64,
    /// The number of this end's next datagram with data, its low half.
    pub(crate) number: u32,
    /// What became of the other end's datagrams.
    pub(crate) arrivals: ArrivalTotals,
}

/// Why a connection is refused or gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ResetReason {
    /// The cloud does not know the connection: it was restarted, or it gave the connection up.
    Unknown,
    /// The cloud has as many connections as it may have.
    Full,
    /// Long datagrams of the cloud do not arrive, short ones do.
    LongLost,
}

/// Every kind of packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Packet<'a> {
    Hello { version: u8, nonce: u64, reply_port: u16 },
    Cookie { nonce: u64, cookie: Cookie },
    Open { nonce: u64, cookie: Cookie, reply_port: u16, terms: Terms },
    Opened { nonce: u64, connection: u64, terms: Terms },
    Data { connection: u64, number: u32, fragment: Fragment<'a> },
    Progress { connection: u64, sequence: u64, end: u32 },
    Lost { connection: u64, sequence: u64, received: u32, total: u32 },
    LostKnown { connection: u64, sequence: u64, tag: u64, total: u32 },
    Ping { connection: u64, sign: SignOfLife },
    Pong { connection: u64, sign: SignOfLife },
    Bye { connection: u64, next: u64 },
    ByeHeard { connection: u64 },
    Path { connection: u64, token: u64 },
    PathConfirmed { connection: u64, token: u64 },
    Reset { id: u64, reason: ResetReason },
}

/// Bytes that are not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum InvalidPacket {
    #[error("a packet of an unknown kind")]
    Kind,
    #[error("a packet of the other direction")]
    Direction,
    #[error("a packet that is too short or too long")]
    Length,
    #[error("a fragment that does not fit its message")]
    Fragment,
}

/// Takes integers from the front of a slice.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], InvalidPacket> {
        let (taken, rest) = self.0.split_first_chunk().ok_or(InvalidPacket::Length)?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u8(&mut self) -> Result<u8, InvalidPacket> {
        self.take().map(u8::from_be_bytes)
    }

    fn u16(&mut self) -> Result<u16, InvalidPacket> {
        self.take().map(u16::from_be_bytes)
    }

    fn u32(&mut self) -> Result<u32, InvalidPacket> {
        self.take().map(u32::from_be_bytes)
    }

    fn u64(&mut self) -> Result<u64, InvalidPacket> {
        self.take().map(u64::from_be_bytes)
    }

    fn terms(&mut self) -> Result<Terms, InvalidPacket> {
        Ok(Terms { window: self.u32()?, datagram: self.u16()? })
    }

    fn sign_of_life(&mut self) -> Result<SignOfLife, InvalidPacket> {
        let (time, next, settled, number) = (self.u64()?, self.u64()?, self.u64()?, self.u32()?);
        let (lost, duplicated, reordered) = (self.u64()?, self.u64()?, self.u64()?);
        let arrivals = ArrivalTotals { lost, duplicated, reordered };
        Ok(SignOfLife { time, next, settled, number, arrivals })
    }

    fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }

    /// Padding, which is sent as zeros and not looked at.
    fn padding(&mut self) {
        self.0 = &[];
    }
}

impl<'a> Packet<'a> {
    /// Reads a body that anybody may have sent to an end of a connection.
    ///
    /// # Errors
    /// When it is not exactly one packet that the other end sends.
    pub(crate) fn read(at: Role, body: &'a [u8]) -> Result<Self, InvalidPacket> {
        let mut reader = Reader(body);
        let kind = reader.u8()?;
        if (kind & FROM_CLOUD != 0) != (at == Role::Edge) {
            return Err(InvalidPacket::Direction);
        }
        let packet = Self::fields(kind & !FROM_CLOUD, at, &mut reader, body.len())?;
        if reader.0.is_empty() { Ok(packet) } else { Err(InvalidPacket::Length) }
    }

    fn fields(kind: u8, at: Role, reader: &mut Reader<'a>, length: usize) -> Result<Self, InvalidPacket> {
        match (kind, at) {
            (1, Role::Cloud) => {
                let packet =
                    Self::Hello { version: reader.u8()?, nonce: reader.u64()?, reply_port: reader.u16()? };
                reader.padding();
                // A shorter one would be answered with more than was sent.
                if length < HELLO_BYTES { Err(InvalidPacket::Length) } else { Ok(packet) }
            }
            (2, Role::Edge) => Ok(Self::Cookie { nonce: reader.u64()?, cookie: reader.take()? }),
            (3, Role::Cloud) => {
                let (nonce, cookie) = (reader.u64()?, reader.take()?);
                let packet = Self::Open { nonce, cookie, reply_port: reader.u16()?, terms: reader.terms()? };
                reader.padding();
                Ok(packet)
            }
            (4, Role::Edge) => {
                let (nonce, connection) = (reader.u64()?, reader.u64()?);
                let packet = Self::Opened { nonce, connection, terms: reader.terms()? };
                reader.padding();
                Ok(packet)
            }
            (5, _) => {
                let (connection, number) = (reader.u64()?, reader.u32()?);
                Ok(Self::Data { connection, number, fragment: fragment(reader)? })
            }
            (6, _) => {
                Ok(Self::Progress { connection: reader.u64()?, sequence: reader.u64()?, end: reader.u32()? })
            }
            (7, _) => {
                let (connection, sequence) = (reader.u64()?, reader.u64()?);
                Ok(Self::Lost { connection, sequence, received: reader.u32()?, total: reader.u32()? })
            }
            (8, _) => {
                let (connection, sequence) = (reader.u64()?, reader.u64()?);
                Ok(Self::LostKnown { connection, sequence, tag: reader.u64()?, total: reader.u32()? })
            }
            (9 | 10, _) => {
                let (connection, sign) = (reader.u64()?, reader.sign_of_life()?);
                Ok(if kind == 9 { Self::Ping { connection, sign } } else { Self::Pong { connection, sign } })
            }
            (11, _) => Ok(Self::Bye { connection: reader.u64()?, next: reader.u64()? }),
            (12, _) => Ok(Self::ByeHeard { connection: reader.u64()? }),
            (13, _) => Ok(Self::Path { connection: reader.u64()?, token: reader.u64()? }),
            (14, _) => Ok(Self::PathConfirmed { connection: reader.u64()?, token: reader.u64()? }),
            (15, Role::Edge) => {
                let id = reader.u64()?;
                let reason = match reader.u8()? {
                    1 => ResetReason::Unknown,
                    2 => ResetReason::Full,
                    3 => ResetReason::LongLost,
                    _ => return Err(InvalidPacket::Kind),
                };
                Ok(Self::Reset { id, reason })
            }
            _ => Err(InvalidPacket::Kind),
        }
    }

    /// Appends the body that an end of a connection sends.
    pub(crate) fn write(&self, from: Role, out: &mut Vec<u8>) {
        let start = out.len();
        out.push(self.kind() | if from == Role::Cloud { FROM_CLOUD } else { 0 });
        let mut put = |bytes: &[u8]| out.extend_from_slice(bytes);
        match *self {
            Self::Hello { version, nonce, reply_port } => {
                put(&[version]);
                put(&nonce.to_be_bytes());
                put(&reply_port.to_be_bytes());
                out.resize(start + HELLO_BYTES, 0);
            }
            Self::Cookie { nonce, cookie } => {
                put(&nonce.to_be_bytes());
                put(&cookie);
            }
            Self::Open { nonce, cookie, reply_port, terms } => {
                put(&nonce.to_be_bytes());
                put(&cookie);
                put(&reply_port.to_be_bytes());
                put(&terms.window.to_be_bytes());
                put(&terms.datagram.to_be_bytes());
            }
            Self::Opened { nonce, connection, terms } => {
                put(&nonce.to_be_bytes());
                put(&connection.to_be_bytes());
                put(&terms.window.to_be_bytes());
                put(&terms.datagram.to_be_bytes());
            }
            Self::Data { connection, number, fragment } => {
                put(&data_header(connection, number, &fragment));
                put(fragment.bytes);
            }
            Self::Progress { connection, sequence, end } => {
                put(&connection.to_be_bytes());
                put(&sequence.to_be_bytes());
                put(&end.to_be_bytes());
            }
            Self::Lost { connection, sequence, received, total } => {
                put(&connection.to_be_bytes());
                put(&sequence.to_be_bytes());
                put(&received.to_be_bytes());
                put(&total.to_be_bytes());
            }
            Self::LostKnown { connection, sequence, tag, total } => {
                put(&connection.to_be_bytes());
                put(&sequence.to_be_bytes());
                put(&tag.to_be_bytes());
                put(&total.to_be_bytes());
            }
            Self::Ping { connection, sign } | Self::Pong { connection, sign } => {
                let SignOfLife { time, next, settled, number, arrivals } = sign;
                [connection, time, next, settled].iter().for_each(|field| put(&field.to_be_bytes()));
                put(&number.to_be_bytes());
                let ArrivalTotals { lost, duplicated, reordered } = arrivals;
                [lost, duplicated, reordered].iter().for_each(|field| put(&field.to_be_bytes()));
            }
            Self::Bye { connection, next } => {
                put(&connection.to_be_bytes());
                put(&next.to_be_bytes());
            }
            Self::ByeHeard { connection } => put(&connection.to_be_bytes()),
            Self::Path { connection, token } | Self::PathConfirmed { connection, token } => {
                put(&connection.to_be_bytes());
                put(&token.to_be_bytes());
            }
            Self::Reset { id, reason } => {
                put(&id.to_be_bytes());
                put(&[match reason {
                    ResetReason::Unknown => 1,
                    ResetReason::Full => 2,
                    ResetReason::LongLost => 3,
                }]);
            }
        }
    }

    /// The connection that the packet belongs to; `None` in the handshake.
    pub(crate) const fn connection(&self) -> Option<u64> {
        match *self {
            Self::Hello { .. } | Self::Cookie { .. } | Self::Open { .. } | Self::Opened { .. } => None,
            Self::Data { connection, .. }
            | Self::Progress { connection, .. }
            | Self::Lost { connection, .. }
            | Self::LostKnown { connection, .. }
            | Self::Ping { connection, .. }
            | Self::Pong { connection, .. }
            | Self::Bye { connection, .. }
            | Self::ByeHeard { connection }
            | Self::Path { connection, .. }
            | Self::PathConfirmed { connection, .. }
            | Self::Reset { id: connection, .. } => Some(connection),
        }
    }

    const fn kind(&self) -> u8 {
        match self {
            Self::Hello { .. } => 1,
            Self::Cookie { .. } => 2,
            Self::Open { .. } => 3,
            Self::Opened { .. } => 4,
            Self::Data { .. } => 5,
            Self::Progress { .. } => 6,
            Self::Lost { .. } => 7,
            Self::LostKnown { .. } => 8,
            Self::Ping { .. } => 9,
            Self::Pong { .. } => 10,
            Self::Bye { .. } => 11,
            Self::ByeHeard { .. } => 12,
            Self::Path { .. } => 13,
            Self::PathConfirmed { .. } => 14,
            Self::Reset { .. } => 15,
        }
    }
}

/// Appends a data packet without the fragment's bytes, which follow.
pub(crate) fn write_data_header(
    from: Role,
    (connection, number): (u64, u32),
    fragment: &Fragment<'_>,
    out: &mut Vec<u8>,
) {
    Packet::Data { connection, number, fragment: Fragment { bytes: &[], ..*fragment } }.write(from, out);
}

/// The fields of a data packet between its kind and the fragment's bytes.
fn data_header(connection: u64, number: u32, fragment: &Fragment<'_>) -> [u8; DATA_HEADER_BYTES - 1] {
    let mut header = [0; DATA_HEADER_BYTES - 1];
    header[..8].copy_from_slice(&connection.to_be_bytes());
    header[8..12].copy_from_slice(&number.to_be_bytes());
    header[12..20].copy_from_slice(&fragment.sequence.to_be_bytes());
    header[20..28].copy_from_slice(&fragment.tag.to_be_bytes());
    header[28..32].copy_from_slice(&fragment.offset.to_be_bytes());
    header[32..36].copy_from_slice(&fragment.total.to_be_bytes());
    header[36..40].copy_from_slice(&fragment.checksum.to_be_bytes());
    header[40..42].copy_from_slice(&fragment.stride.to_be_bytes());
    header[42..].copy_from_slice(&fragment.lifetime_ms.to_be_bytes());
    header
}

fn fragment<'a>(reader: &mut Reader<'a>) -> Result<Fragment<'a>, InvalidPacket> {
    let (sequence, tag) = (reader.u64()?, reader.u64()?);
    let (offset, total, checksum) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let (stride, lifetime_ms) = (reader.u16()?, reader.u16()?);
    let bytes = reader.rest();
    let is_aligned = stride > 0 && offset % u32::from(stride) == 0;
    // A number at the end of all numbers leaves no room for the next.
    if !is_aligned || offset >= total || sequence == u64::MAX {
        return Err(InvalidPacket::Fragment);
    }
    if bytes.len() as u64 != u64::from((total - offset).min(u32::from(stride))) {
        return Err(InvalidPacket::Fragment);
    }
    Ok(Fragment { sequence, tag, offset, total, checksum, stride, lifetime_ms, bytes })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn both_ways(from: Role, packet: Packet<'_>) -> usize {
        let to = if from == Role::Edge { Role::Cloud } else { Role::Edge };
        let mut wire = Vec::new();
        packet.write(from, &mut wire);
        assert_eq!(Packet::read(to, &wire), Ok(packet));
        assert_eq!(Packet::read(from, &wire), Err(InvalidPacket::Direction));
        wire.len()
    }

    #[test]
    fn packets_read_back_as_written() {
        let (nonce, connection, cookie) = (7, u64::MAX, [9; 16]);
        let terms = Terms { window: 1 << 20, datagram: 1_200 };
        let hello = both_ways(Role::Edge, Packet::Hello { version: 1, nonce, reply_port: 5_552 });
        let answer = both_ways(Role::Cloud, Packet::Cookie { nonce, cookie });
        assert!(answer <= hello, "no response is larger than its request");
        both_ways(Role::Edge, Packet::Open { nonce, cookie, reply_port: 0, terms });
        both_ways(Role::Cloud, Packet::Opened { nonce, connection, terms });
        let reset = both_ways(Role::Cloud, Packet::Reset { id: connection, reason: ResetReason::Full });
        for from in [Role::Edge, Role::Cloud] {
            let bytes = &[1, 2, 3][..];
            let fragment = Fragment {
                sequence: 5,
                tag: 6,
                offset: 8,
                total: 11,
                checksum: 12,
                stride: 4,
                lifetime_ms: 13,
                bytes,
            };
            let data = both_ways(from, Packet::Data { connection, number: 14, fragment });
            assert_eq!(data, DATA_HEADER_BYTES + bytes.len());
            both_ways(from, Packet::Progress { connection, sequence: 3, end: 4 });
            both_ways(from, Packet::Lost { connection, sequence: 3, received: 1, total: 2 });
            both_ways(from, Packet::LostKnown { connection, sequence: 3, tag: 1, total: 2 });
            let arrivals = ArrivalTotals { lost: 5, duplicated: 6, reordered: 7 };
            let sign = SignOfLife { time: 1, next: 2, settled: 3, number: 4, arrivals };
            let ping = both_ways(from, Packet::Ping { connection, sign });
            both_ways(from, Packet::Pong { connection, sign });
            let bye = both_ways(from, Packet::Bye { connection, next: 2 });
            let heard = both_ways(from, Packet::ByeHeard { connection });
            both_ways(from, Packet::Path { connection, token: 2 });
            both_ways(from, Packet::PathConfirmed { connection, token: 2 });
            assert!(heard <= bye && reset <= ping && reset <= data);
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..80), kind in 0_u8..=16) {
            for role in [Role::Edge, Role::Cloud] {
                let _ = Packet::read(role, &bytes);
                let mut known = bytes.clone();
                if let Some(first) = known.first_mut() {
                    *first = kind | if role == Role::Edge { FROM_CLOUD } else { 0 };
                }
                let _ = Packet::read(role, &known);
            }
        }
    }
}
