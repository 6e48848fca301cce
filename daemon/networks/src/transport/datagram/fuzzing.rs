//! Arbitrary datagrams at a cloud's port, for the fuzz target in `fuzz/` and for a test.

use std::net::SocketAddr;

use peernet_clock::{MonoTime, Span};

use super::arrival_counter::ArrivalTotals;
use super::connection::ConnectionLimits;
use super::endpoint::{Endpoint, EndpointLimits};
use super::packet::{Fragment, Heartbeat, Packet, Role, Terms};
use super::reassembly::ReassemblyLimits;
use super::sending::QueueLimits;
use crate::transport::{ConnectionId, ListenerEvent};

const PREFIX: &[u8] = b"\x01x";
const TERMS: Terms = Terms { window: 1 << 16, max_datagram_bytes: 600 };
const MAX_UNFINISHED_BYTES: u64 = 100_000;

/// A port with one open connection.
struct Port {
    endpoint: Endpoint,
    connection: u64,
    now: MonoTime,
    peer_address: SocketAddr,
    unverified_address: SocketAddr,
}

/// Runs a script of steps against a port.
///
/// Each step is a byte for its kind, a byte for the number of its bytes, and these bytes. The steps deliver arbitrary
/// bytes, fragments, and packets of an open connection with arbitrary fields; send messages; and advance the time.
///
/// # Panics
/// If an invariant is violated:
/// - an unverified address gets more bytes than came from it,
/// - a connection moves to an unverified address,
/// - messages take more memory than the limit, or
/// - more datagrams count as lost or as reordered than were sent.
pub fn run_datagram_script(script: &[u8]) {
    let Some(mut port) = Port::open() else { panic!("the handshake opens a connection") };
    let mut rest = script;
    while let [step_kind, length, step_and_rest @ ..] = rest {
        let (bytes, later_steps) = step_and_rest.split_at(usize::from(*length).min(step_and_rest.len()));
        rest = later_steps;
        port.step(*step_kind, bytes);
    }
}

impl Port {
    fn open() -> Option<Self> {
        let limits = EndpointLimits {
            connection: ConnectionLimits {
                heartbeat_interval: Span::from_seconds(1),
                heartbeat_timeout: Span::from_seconds(5),
                queue: QueueLimits { max_messages: 4, max_bytes: 10_000 },
                bits_per_second: None,
            },
            reassembly: ReassemblyLimits {
                max_message_bytes: 50_000,
                max_unfinished_messages: 4,
                timeout: Span::from_millis(100),
                idle_timeout: Span::from_seconds(5),
            },
            max_unfinished_bytes: MAX_UNFINISHED_BYTES,
            max_connections: 8,
            hello_timeout: Span::from_seconds(5),
            terms: TERMS,
        };
        let peer_address = SocketAddr::from(([192, 0, 2, 1], 1));
        let mut port = Self {
            endpoint: Endpoint::new([7; 32], PREFIX, limits),
            connection: 0,
            now: MonoTime::default(),
            peer_address,
            unverified_address: SocketAddr::from(([198, 51, 100, 1], 2)),
        };
        let answer =
            port.deliver_packet(peer_address, &Packet::Hello { version: 1, nonce: 3, reply_port: 0 });
        let Ok(Packet::Cookie { nonce, cookie }) = Packet::read(Role::Edge, answer.get(PREFIX.len()..)?)
        else {
            return None;
        };
        let answer =
            port.deliver_packet(peer_address, &Packet::Open { nonce, cookie, reply_port: 0, terms: TERMS });
        let Ok(Packet::Opened { connection, .. }) = Packet::read(Role::Edge, answer.get(PREFIX.len()..)?)
        else {
            return None;
        };
        port.connection = connection;
        port.endpoint.admit(ConnectionId(connection));
        Some(port)
    }

    /// Delivers a packet. Returns all bytes that are sent back to its source.
    fn deliver_packet(&mut self, from: SocketAddr, packet: &Packet<'_>) -> Vec<u8> {
        let mut body = Vec::new();
        packet.write(Role::Edge, &mut body);
        self.deliver(from, &body)
    }

    /// Delivers a datagram with this body. Returns all bytes that are sent back to its source.
    fn deliver(&mut self, from: SocketAddr, body: &[u8]) -> Vec<u8> {
        self.endpoint.receive(from, None, body, self.now);
        let (mut response, mut out) = (Vec::new(), Vec::new());
        // The loop ends, because the number of control packets of a connection is bounded, and its messages wait when
        // the congestion window is full.
        while let Some((route, _)) = self.endpoint.fill(&mut out, 4, self.now) {
            if route.to == from {
                response.extend_from_slice(&out);
            }
            out.clear();
        }
        while let Some(delivery) = self.endpoint.next_delivery() {
            assert!(!matches!(delivery.event, ListenerEvent::Moved(_, to) if to == self.unverified_address));
        }
        let sent = self.endpoint.statistics(ConnectionId(self.connection), self.now).sent;
        assert!(sent.lost.max(sent.reordered) <= sent.datagrams, "{sent:?}");
        // Connections without a session have a separate budget of 16 MiB.
        assert!(self.endpoint.reserved_bytes() <= MAX_UNFINISHED_BYTES + 16 * 1024 * 1024);
        response
    }

    fn step(&mut self, step_kind: u8, bytes: &[u8]) {
        let from = if step_kind & 0x80 == 0 { self.peer_address } else { self.unverified_address };
        let number = |index: usize| u64::from(bytes.get(index).copied().unwrap_or_default());
        let connection = self.connection;
        // The offset is a multiple of the stride, so that the fragment can be valid.
        let fragment = Fragment {
            sequence: number(0),
            tag: number(1),
            offset: number(2) as u32 * number(4) as u32,
            total_bytes: number(3) as u32 * 16,
            checksum: number(5) as u32,
            stride: number(4) as u16,
            lifetime_ms: number(6) as u16,
            bytes: bytes.get(7..).unwrap_or_default(),
        };
        let (sequence, large_number) = (number(0), number(1) << (number(2) % 64));
        let arrivals = ArrivalTotals { lost: number(3), duplicated: large_number, reordered: number(4) };
        let heartbeat = |next, settled| Heartbeat {
            time: large_number,
            next,
            settled,
            number: large_number as u32,
            arrivals,
        };
        let packet = match step_kind & 0x0f {
            0 => {
                self.deliver_and_check(from, bytes);
                return;
            }
            1 => {
                self.now = self.now + Span::from_millis(large_number as i64 & 0xffff);
                self.endpoint.tick(self.now);
                return;
            }
            2 => {
                let sent =
                    self.endpoint.send(ConnectionId(connection), vec![bytes.to_vec().into()], Some(sequence));
                // The queue may be full, or the connection may have ended.
                drop(sent);
                return;
            }
            3 => Packet::Progress { connection, sequence: large_number, end: sequence as u32 },
            4 => Packet::Lost {
                connection,
                sequence,
                received: large_number as u32,
                total: large_number as u32,
            },
            5 => Packet::LostAck { connection, sequence, tag: large_number, total: large_number as u32 },
            6 => Packet::Ping { connection, heartbeat: heartbeat(large_number, sequence) },
            7 => Packet::Pong { connection, heartbeat: heartbeat(sequence, large_number) },
            8 => Packet::Bye { connection, next: large_number },
            9 => Packet::PathResponse { connection, token: large_number },
            10 => Packet::Hello { version: 1, nonce: large_number, reply_port: 0 },
            11 => Packet::Data { connection: large_number, number: 0, fragment },
            12 => Packet::Data {
                connection,
                number: large_number as u32,
                fragment: Fragment { sequence: large_number, ..fragment },
            },
            _ => Packet::Data { connection, number: sequence as u32, fragment },
        };
        let mut body = Vec::new();
        packet.write(Role::Edge, &mut body);
        self.deliver_and_check(from, &body);
    }

    /// Delivers a datagram with this body and checks that the unverified address gets no more bytes back than it sent.
    fn deliver_and_check(&mut self, from: SocketAddr, body: &[u8]) {
        let response = self.deliver(from, body);
        if from == self.unverified_address {
            assert!(
                response.len() <= PREFIX.len() + body.len(),
                "{} bytes answer a datagram of {} bytes",
                response.len(),
                body.len()
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn invariants_hold_for_any_datagrams(script in proptest::collection::vec(any::<u8>(), 0..600)) {
            super::run_datagram_script(&script);
        }
    }

    #[test]
    fn invariants_hold_for_fuzz_corpus() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/corpus/datagrams");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).expect("the corpus") {
            super::run_datagram_script(&std::fs::read(entry.expect("an entry").path()).expect("readable"));
            count += 1;
        }
        assert!(count >= 4, "the corpus has {count} files");
    }
}
