//! The wire form of packets: fixed layouts, integers in network byte order.
//!
//! The first byte is the kind. Its highest bit is set in packets of a cloud, so that a packet that is reflected to its
//! sender is not valid there. Nonces and the numbers of connections are random. The table states the length of each
//! field in bits.
//!
//! | kind | from | fields |
//! | --- | --- | --- |
//! | 1 hello | edge | version 8, nonce 64, reply port 16, zeros up to a length of 64 bytes |
//! | 2 cookie | cloud | nonce 64, cookie 128 |
//! | 3 open | edge | nonce 64, cookie 128, reply port 16, window 32, longest datagram 16, zeros up to the length of the longest datagram |
//! | 4 opened | cloud | nonce 64, connection 64, window 32, longest datagram 16, zeros up to the length of the longest datagram |
//! | 5 data | both | connection 64, number 32, sequence 64, tag 64, offset 32, total bytes 32, checksum 32, stride 16, lifetime 16, bytes |
//! | 6 progress | both | connection 64, sequence 64, end 32 |
//! | 7 lost | both | connection 64, sequence 64, received fragments 32, total fragments 32 |
//! | 8 lost-ack | both | connection 64, sequence 64, tag 64, total fragments 32 |
//! | 9 ping, 10 pong | both | connection 64, time 64, next sequence 64, settled sequence 64, next number 32, lost 64, duplicated 64, reordered 64 |
//! | 11 bye | both | connection 64, next sequence 64 |
//! | 12 bye-ack | both | connection 64 |
//! | 13 path-challenge, 14 path-response | both | connection 64, token 64 |
//! | 15 reset | cloud | connection or nonce 64, reason 8 |
//!
//! `number` is the lower 32 bits of the datagram's number, and `sequence` is the number of a message. A progress packet
//! says that everything up to the offset `end` of a message has arrived or is lost. A lost packet says that a message
//! is lost, and that `received` of its `total` fragments have arrived; `total` is 0 if none has arrived. The lost-ack
//! packet confirms this loss, with the tag and the number of fragments of the message. A path challenge asks the end at
//! a new address to return the token. A reset ends a connection, or refuses the connection with the nonce of its hello.

use super::arrival_counter::ArrivalTotals;

mod read;

/// Version of this layout.
pub(crate) const VERSION: u8 = 1;

/// Length of a hello: more than the cookie that answers it. Bytes.
pub(crate) const HELLO_BYTES: usize = 64;

/// Length of a data packet without the fragment's bytes. Bytes.
pub(crate) const DATA_HEADER_BYTES: usize = 1 + 8 + 4 + 8 + 8 + 4 + 4 + 4 + 2 + 2;

/// Bit of the kind that is set in packets of a cloud.
const FROM_CLOUD: u8 = 0x80;

/// A cookie, which proves that an address receives what is sent to it.
pub(crate) type Cookie = [u8; 16];

/// The two ends of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// The end that opens connections.
    Edge,
    /// The end that accepts connections.
    Cloud,
}

/// Terms that an end of a connection asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Terms {
    /// Maximum number of bytes in flight to this end.
    pub(crate) window: u32,
    /// Largest datagram that may be sent to this end. Bytes.
    pub(crate) max_datagram_bytes: u16,
}

/// A part of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fragment<'a> {
    /// Number of the message in its connection and direction.
    pub(crate) sequence: u64,
    /// The sender's number for the message, plus one; 0 for none.
    pub(crate) tag: u64,
    /// Offset of the bytes in the message; a multiple of the stride.
    pub(crate) offset: u32,
    /// Length of the whole message. Bytes.
    pub(crate) total_bytes: u32,
    /// CRC-32 of the whole message.
    pub(crate) checksum: u32,
    /// Length of every fragment but the last. Bytes.
    pub(crate) stride: u16,
    /// Time after which the message is of no use; 0 if it stays useful. Milliseconds.
    pub(crate) lifetime_ms: u16,
    /// The bytes.
    pub(crate) bytes: &'a [u8],
}

/// A heartbeat: the progress of an end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Heartbeat {
    /// Departure of the ping on its sender's clock, in nanoseconds. The pong repeats it.
    pub(crate) time: u64,
    /// All messages of this end with a lower number have been sent.
    pub(crate) next: u64,
    /// All messages of the other end with a lower number are settled at this end.
    pub(crate) settled: u64,
    /// Lower 32 bits of the number of this end's next datagram with data.
    pub(crate) number: u32,
    /// Totals of the other end's datagrams.
    pub(crate) arrivals: ArrivalTotals,
}

/// Reason why a connection is refused or gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ResetReason {
    /// The cloud does not know the connection: it was restarted, or it gave the connection up.
    Unknown,
    /// The cloud has as many connections as it may have.
    Full,
    /// Long datagrams of the cloud do not arrive, short ones do.
    LongLost,
}

/// A packet; each variant is one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Packet<'a> {
    Hello { version: u8, nonce: u64, reply_port: u16 },
    Cookie { nonce: u64, cookie: Cookie },
    Open { nonce: u64, cookie: Cookie, reply_port: u16, terms: Terms },
    Opened { nonce: u64, connection: u64, terms: Terms },
    Data { connection: u64, number: u32, fragment: Fragment<'a> },
    Progress { connection: u64, sequence: u64, end: u32 },
    Lost { connection: u64, sequence: u64, received: u32, total: u32 },
    LostAck { connection: u64, sequence: u64, tag: u64, total: u32 },
    Ping { connection: u64, heartbeat: Heartbeat },
    Pong { connection: u64, heartbeat: Heartbeat },
    Bye { connection: u64, next: u64 },
    ByeAck { connection: u64 },
    PathChallenge { connection: u64, token: u64 },
    PathResponse { connection: u64, token: u64 },
    Reset { id: u64, reason: ResetReason },
}

/// Error: bytes are not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum InvalidPacket {
    #[error("a packet of an unknown kind")]
    UnknownKind,
    #[error("a reset with an unknown reason")]
    UnknownResetReason,
    #[error("a packet of the other direction")]
    WrongDirection,
    #[error("a packet that is too short or too long")]
    WrongLength,
    #[error("a fragment that does not fit its message")]
    InvalidFragment,
}

impl Packet<'_> {
    /// Appends the wire form of a packet that an end of a connection sends.
    pub(crate) fn write(&self, from: Role, out: &mut Vec<u8>) {
        let start = out.len();
        out.push(self.kind() | if from == Role::Cloud { FROM_CLOUD } else { 0 });
        let mut put = |bytes: &[u8]| out.extend_from_slice(bytes);
        match *self {
            Self::Hello { version, nonce, reply_port } => {
                put(&[version]);
                put(&nonce.to_be_bytes());
                put(&reply_port.to_be_bytes());
                // The hello is padded, because the answer goes to an address that is not verified. The answer must not
                // be longer than the hello.
                out.resize(start + HELLO_BYTES, 0);
            }
            Self::Cookie { nonce, cookie } => {
                put(&nonce.to_be_bytes());
                put(&cookie);
            }
            // The caller appends the zeros to an open and to an opened packet.
            Self::Open { nonce, cookie, reply_port, terms } => {
                put(&nonce.to_be_bytes());
                put(&cookie);
                put(&reply_port.to_be_bytes());
                put(&terms.window.to_be_bytes());
                put(&terms.max_datagram_bytes.to_be_bytes());
            }
            Self::Opened { nonce, connection, terms } => {
                put(&nonce.to_be_bytes());
                put(&connection.to_be_bytes());
                put(&terms.window.to_be_bytes());
                put(&terms.max_datagram_bytes.to_be_bytes());
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
            Self::LostAck { connection, sequence, tag, total } => {
                put(&connection.to_be_bytes());
                put(&sequence.to_be_bytes());
                put(&tag.to_be_bytes());
                put(&total.to_be_bytes());
            }
            Self::Ping { connection, heartbeat } | Self::Pong { connection, heartbeat } => {
                let Heartbeat { time, next, settled, number, arrivals } = heartbeat;
                [connection, time, next, settled].iter().for_each(|field| put(&field.to_be_bytes()));
                put(&number.to_be_bytes());
                let ArrivalTotals { lost, duplicated, reordered } = arrivals;
                [lost, duplicated, reordered].iter().for_each(|field| put(&field.to_be_bytes()));
            }
            Self::Bye { connection, next } => {
                put(&connection.to_be_bytes());
                put(&next.to_be_bytes());
            }
            Self::ByeAck { connection } => put(&connection.to_be_bytes()),
            Self::PathChallenge { connection, token } | Self::PathResponse { connection, token } => {
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

    /// Returns the connection of the packet; `None` for packets of the handshake. For a reset that refuses a
    /// connection, returns the nonce of the hello.
    pub(crate) const fn connection(&self) -> Option<u64> {
        match *self {
            Self::Hello { .. } | Self::Cookie { .. } | Self::Open { .. } | Self::Opened { .. } => None,
            Self::Data { connection, .. }
            | Self::Progress { connection, .. }
            | Self::Lost { connection, .. }
            | Self::LostAck { connection, .. }
            | Self::Ping { connection, .. }
            | Self::Pong { connection, .. }
            | Self::Bye { connection, .. }
            | Self::ByeAck { connection }
            | Self::PathChallenge { connection, .. }
            | Self::PathResponse { connection, .. }
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
            Self::LostAck { .. } => 8,
            Self::Ping { .. } => 9,
            Self::Pong { .. } => 10,
            Self::Bye { .. } => 11,
            Self::ByeAck { .. } => 12,
            Self::PathChallenge { .. } => 13,
            Self::PathResponse { .. } => 14,
            Self::Reset { .. } => 15,
        }
    }
}

/// Appends a data packet without the fragment's bytes, which the caller appends.
pub(crate) fn write_data_header(
    from: Role,
    (connection, number): (u64, u32),
    fragment: &Fragment<'_>,
    out: &mut Vec<u8>,
) {
    Packet::Data { connection, number, fragment: Fragment { bytes: &[], ..*fragment } }.write(from, out);
}

/// Returns the fields of a data packet between its kind and the fragment's bytes.
fn data_header(connection: u64, number: u32, fragment: &Fragment<'_>) -> [u8; DATA_HEADER_BYTES - 1] {
    let mut header = [0; DATA_HEADER_BYTES - 1];
    header[..8].copy_from_slice(&connection.to_be_bytes());
    header[8..12].copy_from_slice(&number.to_be_bytes());
    header[12..20].copy_from_slice(&fragment.sequence.to_be_bytes());
    header[20..28].copy_from_slice(&fragment.tag.to_be_bytes());
    header[28..32].copy_from_slice(&fragment.offset.to_be_bytes());
    header[32..36].copy_from_slice(&fragment.total_bytes.to_be_bytes());
    header[36..40].copy_from_slice(&fragment.checksum.to_be_bytes());
    header[40..42].copy_from_slice(&fragment.stride.to_be_bytes());
    header[42..].copy_from_slice(&fragment.lifetime_ms.to_be_bytes());
    header
}

#[cfg(test)]
mod tests;
