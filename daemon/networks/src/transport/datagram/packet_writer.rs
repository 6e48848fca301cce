//! Writes the datagrams of one end of a connection.

use super::packet::{DATA_HEADER_BYTES, Fragment, Packet, Role, write_data_header};

/// Writes datagrams of a connection. Each datagram begins with a prefix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PacketWriter {
    role: Role,
    connection: u64,
    prefix: &'static [u8],
}

impl PacketWriter {
    pub(crate) const fn new(role: Role, connection: u64, prefix: &'static [u8]) -> Self {
        Self { role, connection, prefix }
    }

    /// Returns the end that writes.
    pub(super) const fn role(&self) -> Role {
        self.role
    }

    /// Returns the number of the connection.
    pub(super) const fn connection(&self) -> u64 {
        self.connection
    }

    /// Returns the length of a datagram with data without the bytes of the fragment.
    pub(super) const fn data_overhead(&self) -> usize {
        self.prefix.len() + DATA_HEADER_BYTES
    }

    /// Appends a datagram with a packet. Returns its length.
    pub(super) fn write(&self, packet: &Packet<'_>, out: &mut Vec<u8>) -> usize {
        let start = out.len();
        out.extend_from_slice(self.prefix);
        packet.write(self.role, out);
        out.len() - start
    }

    /// Appends the beginning of a datagram with data. The caller appends the fragment's bytes.
    pub(super) fn write_data_header(&self, number: u32, fragment: &Fragment<'_>, out: &mut Vec<u8>) {
        out.extend_from_slice(self.prefix);
        write_data_header(self.role, (self.connection, number), fragment, out);
    }
}
