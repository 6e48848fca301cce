//! Decodes packets from untrusted bytes.

use super::{
    ArrivalTotals, FROM_CLOUD, Fragment, HELLO_BYTES, Heartbeat, InvalidPacket, Packet, ResetReason, Role,
    Terms,
};

/// Removes integers from the front of a slice.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], InvalidPacket> {
        let (bytes, rest) = self.0.split_first_chunk().ok_or(InvalidPacket::WrongLength)?;
        self.0 = rest;
        Ok(*bytes)
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
        Ok(Terms { window: self.u32()?, max_datagram_bytes: self.u16()? })
    }

    fn heartbeat(&mut self) -> Result<Heartbeat, InvalidPacket> {
        let (time, next, settled, number) = (self.u64()?, self.u64()?, self.u64()?, self.u32()?);
        let (lost, duplicated, reordered) = (self.u64()?, self.u64()?, self.u64()?);
        let arrivals = ArrivalTotals { lost, duplicated, reordered };
        Ok(Heartbeat { time, next, settled, number, arrivals })
    }

    fn read_rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }

    /// Skips the padding, which is sent as zeros and not checked.
    fn skip_padding(&mut self) {
        self.0 = &[];
    }
}

impl<'a> Packet<'a> {
    /// Decodes an untrusted body that arrived at an end of a connection.
    ///
    /// # Errors
    /// If the body is not exactly one packet that the other end may send.
    pub(crate) fn read(receiver: Role, body: &'a [u8]) -> Result<Self, InvalidPacket> {
        let mut reader = Reader(body);
        let kind = reader.u8()?;
        if (kind & FROM_CLOUD != 0) != (receiver == Role::Edge) {
            return Err(InvalidPacket::WrongDirection);
        }
        let packet = read_fields(kind & !FROM_CLOUD, receiver, &mut reader, body.len())?;
        if reader.0.is_empty() { Ok(packet) } else { Err(InvalidPacket::WrongLength) }
    }
}

/// Decodes the fields of a packet of this kind.
fn read_fields<'a>(
    kind: u8,
    receiver: Role,
    reader: &mut Reader<'a>,
    length: usize,
) -> Result<Packet<'a>, InvalidPacket> {
    match (kind, receiver) {
        (1, Role::Cloud) => {
            let packet =
                Packet::Hello { version: reader.u8()?, nonce: reader.u64()?, reply_port: reader.u16()? };
            reader.skip_padding();
            // The answer to a shorter hello would be longer than the hello.
            if length < HELLO_BYTES { Err(InvalidPacket::WrongLength) } else { Ok(packet) }
        }
        (2, Role::Edge) => Ok(Packet::Cookie { nonce: reader.u64()?, cookie: reader.take()? }),
        (3, Role::Cloud) => {
            let (nonce, cookie) = (reader.u64()?, reader.take()?);
            let packet = Packet::Open { nonce, cookie, reply_port: reader.u16()?, terms: reader.terms()? };
            reader.skip_padding();
            Ok(packet)
        }
        (4, Role::Edge) => {
            let (nonce, connection) = (reader.u64()?, reader.u64()?);
            let packet = Packet::Opened { nonce, connection, terms: reader.terms()? };
            reader.skip_padding();
            Ok(packet)
        }
        (5, _) => {
            let (connection, number) = (reader.u64()?, reader.u32()?);
            Ok(Packet::Data { connection, number, fragment: read_fragment(reader)? })
        }
        (6, _) => {
            Ok(Packet::Progress { connection: reader.u64()?, sequence: reader.u64()?, end: reader.u32()? })
        }
        (7, _) => {
            let (connection, sequence) = (reader.u64()?, reader.u64()?);
            Ok(Packet::Lost { connection, sequence, received: reader.u32()?, total: reader.u32()? })
        }
        (8, _) => {
            let (connection, sequence) = (reader.u64()?, reader.u64()?);
            Ok(Packet::LostAck { connection, sequence, tag: reader.u64()?, total: reader.u32()? })
        }
        (9 | 10, _) => {
            let (connection, heartbeat) = (reader.u64()?, reader.heartbeat()?);
            Ok(if kind == 9 {
                Packet::Ping { connection, heartbeat }
            } else {
                Packet::Pong { connection, heartbeat }
            })
        }
        (11, _) => Ok(Packet::Bye { connection: reader.u64()?, next: reader.u64()? }),
        (12, _) => Ok(Packet::ByeAck { connection: reader.u64()? }),
        (13, _) => Ok(Packet::PathChallenge { connection: reader.u64()?, token: reader.u64()? }),
        (14, _) => Ok(Packet::PathResponse { connection: reader.u64()?, token: reader.u64()? }),
        (15, Role::Edge) => {
            let id = reader.u64()?;
            let reason = match reader.u8()? {
                1 => ResetReason::Unknown,
                2 => ResetReason::Full,
                3 => ResetReason::LongLost,
                _ => return Err(InvalidPacket::UnknownResetReason),
            };
            Ok(Packet::Reset { id, reason })
        }
        _ => Err(InvalidPacket::UnknownKind),
    }
}

fn read_fragment<'a>(reader: &mut Reader<'a>) -> Result<Fragment<'a>, InvalidPacket> {
    let (sequence, tag) = (reader.u64()?, reader.u64()?);
    let (offset, total_bytes, checksum) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let (stride, lifetime_ms) = (reader.u16()?, reader.u16()?);
    let bytes = reader.read_rest();
    let is_aligned = stride > 0 && offset % u32::from(stride) == 0;
    // The highest number is refused, because there is no number after it.
    if !is_aligned || offset >= total_bytes || sequence == u64::MAX {
        return Err(InvalidPacket::InvalidFragment);
    }
    if bytes.len() as u64 != u64::from((total_bytes - offset).min(u32::from(stride))) {
        return Err(InvalidPacket::InvalidFragment);
    }
    Ok(Fragment { sequence, tag, offset, total_bytes, checksum, stride, lifetime_ms, bytes })
}
