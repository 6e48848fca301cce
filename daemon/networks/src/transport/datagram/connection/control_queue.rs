//! Queue of packets that carry no part of a message.

use std::collections::VecDeque;

use crate::transport::datagram::packet::Packet;
use crate::transport::datagram::packet_writer::PacketWriter;
use crate::transport::datagram::sending::Batch;

/// Maximum number of queued packets. The limit is reached only while nothing can be sent. Further packets can be
/// dropped, because every packet of this queue is sent again later if it is lost.
const MAX_PACKETS: usize = 256;

/// Packets of a connection that are sent before its messages.
#[derive(Debug)]
pub(super) struct ControlQueue {
    writer: PacketWriter,
    packets: VecDeque<Packet<'static>>,
}

impl ControlQueue {
    pub(super) const fn new(writer: PacketWriter) -> Self {
        Self { writer, packets: VecDeque::new() }
    }

    /// Queues a packet. Drops it if the queue is full.
    pub(super) fn push(&mut self, packet: Packet<'static>) {
        if self.packets.len() < MAX_PACKETS {
            self.packets.push_back(packet);
        }
    }

    pub(super) fn clear(&mut self) {
        self.packets.clear();
    }

    /// Appends the datagram of the next packet.
    pub(super) fn fill(&mut self, out: &mut Vec<u8>) -> Option<Batch> {
        let packet = self.packets.pop_front()?;
        Some(Batch { segment: self.writer.write(&packet, out), count: 1 })
    }
}
