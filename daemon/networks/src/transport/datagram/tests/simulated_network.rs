//! An edge and a cloud over a simulated path that loses, duplicates and reorders datagrams.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use super::super::connection::{Connection, Event};
use super::super::endpoint::Endpoint;
use super::super::handshake::{DialState, HandshakeOutcome};
use super::super::packet::{Packet, Role};
use super::super::packet_writer::PacketWriter;
use super::{PREFIX, TERMS, limits};
use crate::transport::memory::MemoryBudget;
use crate::transport::{ConnectionId, ListenerEvent};

/// Probabilities of impairments of each datagram. Percent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Impairment {
    pub(super) loss: u64,
    pub(super) duplicated: u64,
    pub(super) reordered: u64,
}

pub(super) const UNIMPAIRED: Impairment = Impairment { loss: 0, duplicated: 0, reordered: 0 };

/// The datagrams in flight between an edge and a cloud.
pub(super) struct ImpairedPath {
    pub(super) impairment: Impairment,
    random: u64,
    /// Largest datagrams that pass: to the cloud, and to the edge. Bytes.
    pub(super) max_bytes: (usize, usize),
    /// Datagrams by arrival: direction (`true` to the cloud), address of the edge, and bytes.
    pub(super) datagrams: BTreeMap<(MonoTime, u64), (bool, SocketAddr, Vec<u8>)>,
    /// Number of datagrams that the path has carried.
    count: u64,
}

impl ImpairedPath {
    /// Returns `true` with a probability of `percent` percent.
    fn chance(&mut self, percent: u64) -> bool {
        // Xorshift is random enough for a simulation.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % 100 < percent
    }

    fn carry(&mut self, to_cloud: bool, address: SocketAddr, datagram: &[u8], now: MonoTime) {
        let (max_upload_bytes, max_download_bytes) = self.max_bytes;
        let is_long = datagram.len() > if to_cloud { max_upload_bytes } else { max_download_bytes };
        let copies = if self.chance(self.impairment.loss) || is_long {
            0
        } else {
            1 + u64::from(self.chance(self.impairment.duplicated))
        };
        for _ in 0..copies {
            let delay_ms = if self.chance(self.impairment.reordered) { 15 } else { 5 };
            self.count += 1;
            let key = (now + Span::from_millis(delay_ms), self.count);
            self.datagrams.insert(key, (to_cloud, address, datagram.to_vec()));
        }
    }

    /// Removes and returns the datagrams that have arrived, in order.
    fn take_due(&mut self, now: MonoTime) -> impl Iterator<Item = (bool, SocketAddr, Vec<u8>)> + use<> {
        let later_datagrams = self.datagrams.split_off(&(now, u64::MAX));
        std::mem::replace(&mut self.datagrams, later_datagrams).into_values()
    }
}

/// An edge, a cloud, and the path between them.
pub(super) struct SimulatedNetwork {
    pub(super) now: MonoTime,
    pub(super) path: ImpairedPath,
    pub(super) edge_address: SocketAddr,
    pub(super) cloud: Endpoint,
    dialling: DialState,
    pub(super) edge: Option<Connection>,
    /// Number of the edge's connection, once it is open.
    edge_id: Option<u64>,
    /// Events at the cloud.
    pub(super) listener_events: Vec<ListenerEvent>,
    /// Events at the edge.
    pub(super) events: Vec<Event>,
}

impl SimulatedNetwork {
    pub(super) fn new(impairment: Impairment, seed: u64) -> Self {
        let now = MonoTime::default();
        Self {
            now,
            path: ImpairedPath {
                impairment,
                random: seed | 1,
                max_bytes: (usize::MAX, usize::MAX),
                datagrams: BTreeMap::new(),
                count: 0,
            },
            edge_address: "192.0.2.1:1000".parse().expect("an address"),
            cloud: Endpoint::new([7; 32], PREFIX, limits()),
            dialling: DialState::new(5, 0, TERMS, PREFIX.len(), now),
            edge: None,
            edge_id: None,
            listener_events: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Advances the time by one millisecond.
    pub(super) fn step(&mut self) {
        self.now = self.now + Span::from_millis(1);
        let now = self.now;
        for (to_cloud, address, datagram) in self.path.take_due(now) {
            let body = datagram.strip_prefix(PREFIX).expect("has the prefix");
            if to_cloud {
                self.cloud.receive(address, None, body, now);
                continue;
            }
            // A packet that a test has altered may be invalid. In the program, the driver counts invalid packets.
            let Ok(packet) = Packet::read(Role::Edge, body) else { continue };
            match &mut self.edge {
                Some(edge) if packet.connection() == self.edge_id => edge.receive(packet, now),
                Some(_) => {}
                None => {
                    if let Some(HandshakeOutcome::Opened { connection, terms }) =
                        self.dialling.receive(&packet, now)
                    {
                        let limits = limits();
                        self.edge_id = Some(connection);
                        self.edge = Some(Connection::new(
                            PacketWriter::new(Role::Edge, connection, PREFIX),
                            terms,
                            limits.connection,
                            (limits.reassembly, MemoryBudget::new(10_000_000)),
                            now,
                        ));
                    }
                }
            }
        }
        let mut out = PREFIX.to_vec();
        if self.edge.is_none()
            && self.dialling.fill(&mut out, now).expect("the path carries datagrams of this length")
        {
            self.path.carry(true, self.edge_address, &out, now);
        }
        if let Some(edge) = &mut self.edge {
            edge.tick(now);
        }
        self.cloud.tick(now);
        loop {
            out.clear();
            let Some(batch) = self.edge.as_mut().and_then(|edge| edge.fill(&mut out, 10, now)) else { break };
            let address = self.edge_address;
            for datagram in out.clone().chunks(batch.segment) {
                assert!(datagram.len() <= TERMS.max_datagram_bytes.into());
                self.path.carry(true, address, datagram, now);
            }
        }
        loop {
            out.clear();
            let Some((route, batch)) = self.cloud.fill(&mut out, 10, now) else { break };
            for datagram in out.clone().chunks(batch.segment) {
                if route.to == self.edge_address {
                    self.path.carry(false, route.to, datagram, now);
                }
            }
        }
        if let Some(edge) = &mut self.edge {
            self.events.extend(std::iter::from_fn(|| edge.next_event()));
        }
        let cloud = &mut self.cloud;
        self.listener_events
            .extend(std::iter::from_fn(|| cloud.next_delivery()).map(|delivery| delivery.event));
    }

    pub(super) fn steps(&mut self, millis: u64) {
        (0..millis).for_each(|_| self.step());
    }

    /// Opens a connection and admits it as a connection with a session.
    pub(super) fn open(&mut self) -> ConnectionId {
        self.send(None, b"hello");
        for _ in 0..20_000 {
            self.step();
            if let Some(ListenerEvent::Message(peer, frames)) = self.listener_events.pop() {
                assert_eq!(frames, [&b"hello"[..]]);
                self.cloud.admit(peer.connection);
                return peer.connection;
            }
        }
        panic!("no hello arrives");
    }

    pub(super) fn send(&mut self, tag: Option<u64>, bytes: &[u8]) {
        for _ in 0..20_000 {
            if let Some(edge) = &mut self.edge {
                edge.send(vec![Bytes::copy_from_slice(bytes)], tag, None).expect("there is room");
                return;
            }
            self.step();
        }
        panic!("no connection opens");
    }
}
