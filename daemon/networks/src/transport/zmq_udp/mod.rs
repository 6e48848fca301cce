//! `zmq-udp`: datagrams in the framing of libzmq's RADIO and DISH sockets, over UDP.
//!
//! The protocol between the two ends is [`datagram`](super::datagram). This module has the framing ([`radio`]), the
//! socket ([`socket`]) and the task that serves it ([`driver`]). A sending task writes to the socket at once if the
//! window allows it.
//!
//! libzmq's UDP engine has no handshake, reads at most 8,192 bytes and does not report addresses to the program that
//! uses it. The protocol between the ends is therefore in the bodies of the datagrams. Each of our ends has one socket.
//! A peer made of libzmq's sockets has two sockets, and its hello names the port of its DISH.

mod cloud;
mod driver;
mod edge;
mod radio;
mod socket;

pub(crate) use cloud::{bind, try_bind};
pub(crate) use edge::dial;

use peernet_clock::Span;

use self::radio::MAX_DATAGRAM_BYTES;
use self::socket::UdpPort;
use super::datagram::MIN_DATAGRAM_BYTES;
use super::datagram::connection::ConnectionLimits;
use super::datagram::packet::Terms;
use super::datagram::reassembly::ReassemblyLimits;
use super::datagram::sending::QueueLimits;
use super::{AddressForm, HostChecks};
use crate::SessionSettings;
use crate::message::MAX_FRAMES;

/// Form of addresses.
pub(crate) const ADDRESS_FORM: AddressForm = AddressForm::HostPort;

/// This network works on every host.
pub(crate) const HOST_CHECKS: HostChecks = HostChecks::NONE;

/// Largest length of the table of frame lengths in a message. Bytes.
const FRAME_TABLE_BYTES: u32 = 2 + 4 * MAX_FRAMES as u32;

/// Returns the length of the longest message in its wire form, which begins with the table of frame lengths. Bytes.
fn max_wire_message_bytes(settings: &SessionSettings) -> u32 {
    u32::try_from(settings.max_message_bytes).unwrap_or(u32::MAX).saturating_add(FRAME_TABLE_BYTES)
}

fn reassembly_limits(settings: &SessionSettings) -> ReassemblyLimits {
    ReassemblyLimits {
        max_message_bytes: max_wire_message_bytes(settings),
        // Every request in flight, and the few messages that open and close a session.
        max_unfinished_messages: settings.max_in_flight as usize + 16,
        timeout: Span::from(settings.reassembly_timeout()),
        idle_timeout: Span::from(settings.heartbeat_timeout()),
    }
}

fn connection_limits(settings: &SessionSettings) -> ConnectionLimits {
    ConnectionLimits {
        heartbeat_interval: Span::from(settings.heartbeat_interval()),
        heartbeat_timeout: Span::from(settings.heartbeat_timeout()),
        queue: QueueLimits {
            // Every request in flight, and the few messages that open and close a session.
            max_messages: settings.max_in_flight as usize + 16,
            // All queued messages together have at most the bytes of one longest message.
            max_bytes: u64::from(max_wire_message_bytes(settings)),
        },
        bits_per_second: (settings.max_send_bits_per_second > 0).then_some(settings.max_send_bits_per_second),
    }
}

fn local_terms(settings: &SessionSettings, socket: &UdpPort) -> Terms {
    let datagram_bytes = u16::try_from(settings.datagram_bytes).unwrap_or(MAX_DATAGRAM_BYTES);
    Terms {
        window: socket.window(),
        max_datagram_bytes: datagram_bytes.clamp(MIN_DATAGRAM_BYTES, MAX_DATAGRAM_BYTES),
    }
}

/// Returns the size of the kernel's receive buffer and of its send buffer. Bytes.
fn socket_buffer_bytes(settings: &SessionSettings) -> usize {
    usize::try_from(settings.socket_buffer_bytes).unwrap_or(usize::MAX)
}
