//! Tests with an edge and a cloud over a simulated network that loses, duplicates and reorders datagrams.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};
use proptest::prelude::*;

use super::connection::{Connection, ConnectionLimits, Event};
use super::endpoint::{Endpoint, EndpointLimits};
use super::handshake::{DialState, HandshakeOutcome};
use super::packet::{Fragment, Heartbeat, Packet, Role, Terms};
use super::reassembly::ReassemblyLimits;
use super::sending::QueueLimits;
use crate::transport::{ConnectionId, ListenerEvent};

mod altered_packets;
mod simulated_network;

use self::simulated_network::{Impairment, SimulatedNetwork, UNIMPAIRED};

/// Beginning of each datagram.
const PREFIX: &[u8] = b"\x01x";
const TERMS: Terms = Terms { window: 1 << 20, max_datagram_bytes: 1_200 };

pub(super) fn limits() -> EndpointLimits {
    EndpointLimits {
        connection: ConnectionLimits {
            // Short enough that 30 % loss in both directions never loses all heartbeats of a timeout by chance.
            heartbeat_interval: Span::from_millis(100),
            heartbeat_timeout: Span::from_seconds(5),
            queue: QueueLimits { max_messages: 100, max_bytes: 10_000_000 },
            bits_per_second: None,
        },
        reassembly: ReassemblyLimits {
            max_message_bytes: 5_000_000,
            max_unfinished_messages: 80,
            timeout: Span::from_millis(100),
            idle_timeout: Span::from_seconds(5),
        },
        max_unfinished_bytes: 10_000_000,
        max_connections: 64,
        hello_timeout: Span::from_seconds(30),
        terms: TERMS,
    }
}

fn payload(tag: u64) -> Vec<u8> {
    let size = [0, 1, 900, 1_100, 5_000, 60_000][tag as usize % 6] + tag as usize;
    (0..size).map(|i| (i as u64 * 7 + tag) as u8).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn every_message_arrives_or_is_lost_at_both_ends(
        loss in 0_u64..30,
        duplicated in 0_u64..20,
        reordered in 0_u64..40,
        seed: u64,
    ) {
        const MESSAGES: u64 = 30;
        let mut network = SimulatedNetwork::new(Impairment { loss, duplicated, reordered }, seed);
        let id = network.open();
        for tag in 0..MESSAGES {
            network.send(Some(tag), &payload(tag));
            network.steps(3);
        }
        network.steps(8_000);
        let mut arrived = BTreeSet::new();
        for event in &network.listener_events {
            match event {
                ListenerEvent::Message(_, frames) => {
                    let tag = (0..MESSAGES).find(|tag| frames[0] == payload(*tag)).expect("the message is as it was sent");
                    prop_assert!(arrived.insert(tag), "message {} arrives twice", tag);
                }
                ListenerEvent::IncomingLost(_, loss) => prop_assert!(loss.received <= loss.total),
                other => prop_assert!(false, "{:?}", other),
            }
        }
        let mut lost = BTreeSet::new();
        for event in &network.events {
            match event {
                Event::OutgoingLost(loss) => {
                    prop_assert!(loss.received < loss.total && lost.insert(loss.tag.expect("the loss has a tag")));
                }
                other => prop_assert!(false, "{:?}", other),
            }
        }
        prop_assert!(arrived.is_disjoint(&lost));
        prop_assert_eq!(arrived.len() + lost.len(), MESSAGES as usize);
        prop_assert!(loss > 0 || lost.is_empty());
        prop_assert_eq!(network.cloud.reserved_bytes(), 0);

        // A message in the other direction, and the goodbye.
        network.cloud.send(id, vec![payload(5).into()], Some(5)).expect("there is room");
        network.steps(4_000);
        let answers = network.events.iter().filter(|event| matches!(
            event, Event::Message(..) | Event::IncomingLost(..)
        )).count();
        prop_assert_eq!(answers, 1);
        let now = network.now;
        network.edge.as_mut().expect("the connection is open").close(now);
        network.steps(8_000);
        prop_assert_eq!(network.cloud.len(), 0);
        let gone = network.listener_events.iter().filter(|event| matches!(event, ListenerEvent::Gone(..))).count();
        prop_assert_eq!(gone, 1);
    }

    #[test]
    fn messages_without_tag_always_arrive_once(loss in 0_u64..25, seed: u64) {
        // Short messages without a tag are retransmitted when they are lost.
        let mut network = SimulatedNetwork::new(Impairment { loss, duplicated: 5, reordered: 10 }, seed);
        network.open();
        for n in 0..10 {
            network.send(None, &[n]);
            network.steps(2);
        }
        network.steps(15_000);
        let arrived: BTreeSet<u8> = network.listener_events.iter().filter_map(|event| match event {
            ListenerEvent::Message(_, frames) => Some(frames[0][0]),
            _ => None,
        }).collect();
        prop_assert_eq!(arrived.len(), 10);
        let is_message = |event: &&ListenerEvent| matches!(event, ListenerEvent::Message(..));
        prop_assert_eq!(network.listener_events.iter().filter(is_message).count(), 10);
    }
}

#[test]
fn silence_ends_connection_at_both_ends() {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    let id = network.open();
    network.steps(7_000);
    assert!(
        network.listener_events.is_empty() && network.events.is_empty(),
        "heartbeats keep the connection open"
    );
    network.path.impairment.loss = 100;
    network.steps(6_000);
    assert!(matches!(network.listener_events[..], [ListenerEvent::Gone(gone, _)] if gone == id));
    assert!(matches!(network.events[..], [Event::Gone(_)]));
}

#[test]
fn restarted_cloud_reports_unknown_connection() {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    network.open();
    network.cloud = Endpoint::new([8; 32], PREFIX, limits());
    network.send(Some(1), b"anybody there?");
    network.steps(20);
    let [Event::Gone(reason)] = &network.events[..] else { panic!("{:?}", network.events) };
    assert!(reason.contains("does not know the connection"), "{reason}");
}

#[test]
fn edge_keeps_connection_after_check_of_new_address() {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    let id = network.open();
    network.edge_address = "192.0.2.77:7".parse().expect("an address");
    network.send(Some(1), b"from elsewhere");
    network.steps(30);
    let moved = network.listener_events.iter().any(
        |event| matches!(event, ListenerEvent::Moved(moved, to) if *moved == id && *to == network.edge_address),
    );
    assert!(moved, "{:?}", network.listener_events);
    network.cloud.send(id, vec!["answer".into()], Some(1)).expect("there is room");
    network.steps(30);
    assert!(matches!(&network.events[..], [Event::Message(frames, _)] if frames[0] == "answer"));
}

#[test]
fn forged_addresses_cause_neither_amplification_nor_memory_use() {
    let mut cloud = Endpoint::new([7; 32], PREFIX, limits());
    let now = MonoTime::default();
    let cookie = [9; 16];
    for n in 0..10_000_u64 {
        let source = SocketAddr::from(([198, 51, (n / 256) as u8, n as u8], 9));
        let packets = [
            Packet::Hello { version: 1, nonce: n, reply_port: 0 },
            Packet::Open { nonce: n, cookie, reply_port: 0, terms: TERMS },
            Packet::Ping { connection: n, heartbeat: Heartbeat { next: n, ..Heartbeat::default() } },
        ];
        for packet in packets {
            let mut body = Vec::new();
            packet.write(Role::Edge, &mut body);
            cloud.receive(source, None, &body, now);
            let mut out = Vec::new();
            while cloud.fill(&mut out, 10, now).is_some() {}
            assert!(out.len() <= PREFIX.len() + body.len(), "{packet:?}");
        }
    }
    assert_eq!(cloud.len(), 0);
}

/// Opens a connection from an address directly, without a network. `None` if it is refused.
fn open_from(cloud: &mut Endpoint, source: SocketAddr, nonce: u64, now: &mut MonoTime) -> Option<u64> {
    let mut dialling = DialState::new(nonce, 0, TERMS, PREFIX.len(), *now);
    let mut opened = None;
    for _ in 0..2 {
        let mut out = Vec::new();
        *now = *now + Span::from_millis(1);
        assert_eq!(dialling.fill(&mut out, *now), Ok(true));
        cloud.receive(source, None, &out, *now);
        let mut answer = Vec::new();
        while let Some((route, batch)) = cloud.fill(&mut answer, 10, *now) {
            let body = &answer[answer.len() - batch.segment + PREFIX.len()..];
            if route.to == source
                && let Ok(packet) = Packet::read(Role::Edge, body)
                && let Some(HandshakeOutcome::Opened { connection, .. }) = dialling.receive(&packet, *now)
            {
                opened = Some(connection);
            }
        }
    }
    opened
}

#[test]
fn connections_without_session_are_bounded_and_end() {
    let mut cloud = Endpoint::new([7; 32], PREFIX, limits());
    let mut now = MonoTime::default();
    for n in 0..200_u64 {
        open_from(&mut cloud, SocketAddr::from(([198, 51, 100, n as u8], 9)), n, &mut now);
        assert!(cloud.len() <= 64);
    }
    assert!(cloud.len() >= 16, "the newest connections stay open");
    now = now + Span::from_seconds(6);
    cloud.tick(now);
    let mut out = Vec::new();
    while cloud.fill(&mut out, 10, now).is_some() {}
    assert_eq!(cloud.len(), 0);
}

#[test]
fn claimed_lengths_take_no_memory_of_other_peers() {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    network.open();
    let other_address = SocketAddr::from(([198, 51, 100, 1], 9));
    let mut now = network.now;
    let connection = open_from(&mut network.cloud, other_address, 77, &mut now).expect("there is room");
    network.cloud.admit(ConnectionId(connection));
    network.now = now;
    let claimed_bytes = limits().reassembly.max_message_bytes;
    for sequence in 0..80 {
        let fragment = Fragment {
            sequence,
            tag: 1,
            offset: if sequence % 2 == 0 { 0 } else { 1_000_000 },
            total_bytes: claimed_bytes,
            checksum: 0,
            stride: 1_000,
            lifetime_ms: 0,
            bytes: &[7; 1_000],
        };
        let mut body = Vec::new();
        Packet::Data { connection, number: sequence as u32, fragment }.write(Role::Edge, &mut body);
        network.cloud.receive(other_address, None, &body, now);
    }
    assert!(
        network.cloud.reserved_bytes() <= 80 * 1_100,
        "{} bytes are reserved",
        network.cloud.reserved_bytes()
    );
    let bytes = vec![9; 3_000_000];
    network.send(Some(1), &bytes);
    network.steps(2_000);
    let arrived =
        |event: &ListenerEvent| matches!(event, ListenerEvent::Message(_, frames) if frames[0] == bytes);
    assert!(
        network.listener_events.iter().any(arrived),
        "{:?}, {:?}",
        network.listener_events.len(),
        network.events
    );
}

#[test]
fn message_without_memory_is_lost_before_fully_sent() {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    network.open();
    let other_address = SocketAddr::from(([198, 51, 100, 1], 9));
    let mut now = network.now;
    let connection = open_from(&mut network.cloud, other_address, 77, &mut now).expect("there is room");
    network.cloud.admit(ConnectionId(connection));
    network.now = now;
    // Fragments of two messages that fill nearly all of the memory.
    for number in 0..9_000 {
        let fragment = Fragment {
            sequence: u64::from(number % 2),
            tag: 1,
            offset: (number / 2 + 1) * 1_000,
            total_bytes: limits().reassembly.max_message_bytes,
            checksum: 0,
            stride: 1_000,
            lifetime_ms: 0,
            bytes: &[7; 1_000],
        };
        let mut body = Vec::new();
        Packet::Data { connection, number, fragment }.write(Role::Edge, &mut body);
        network.cloud.receive(other_address, None, &body, now);
    }
    network.send(Some(1), &vec![9; 3_000_000]);
    let lost = |event: &Event| matches!(event, Event::OutgoingLost(loss) if loss.tag == Some(1));
    for _ in 0..1_000 {
        network.step();
        if network.events.iter().any(lost) {
            break;
        }
    }
    assert!(network.events.iter().any(lost), "{} bytes are reserved", network.cloud.reserved_bytes());
    network.send(Some(2), b"small");
    network.steps(50);
    let arrived =
        |event: &ListenerEvent| matches!(event, ListenerEvent::Message(_, frames) if frames[0] == "small");
    assert!(network.listener_events.iter().any(arrived), "{:?}", network.listener_events);
}

#[test]
fn handshake_falls_back_to_short_datagrams() {
    let mut now = MonoTime::default();
    let large_terms = Terms { max_datagram_bytes: 8_000, ..TERMS };
    let mut dialling = DialState::new(1, 0, large_terms, PREFIX.len(), now);
    dialling.receive(&Packet::Cookie { nonce: 1, cookie: [1; 16] }, now);
    let mut lengths = Vec::new();
    for _ in 0..4 {
        let mut out = PREFIX.to_vec();
        now = dialling.next_timer().max(now);
        assert_eq!(dialling.fill(&mut out, now), Ok(true));
        lengths.push(out.len());
    }
    assert_eq!(lengths, [8_000, 8_000, 8_000, 1_200]);
    let started_at = now;
    let error = loop {
        now = dialling.next_timer();
        dialling.receive(&Packet::Cookie { nonce: 1, cookie: [1; 16] }, now);
        if let Err(error) = dialling.fill(&mut Vec::new(), now) {
            break error.to_string();
        }
    };
    assert!(now - started_at < Span::from_seconds(10), "{}", now - started_at);
    assert!(error.contains("none of 1200 bytes") && error.contains("datagram_bytes"), "{error}");
}

#[test]
fn connection_ends_when_path_stops_carrying_long_datagrams() {
    for loses_upload in [true, false] {
        let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
        let id = network.open();
        network.path.max_bytes = if loses_upload { (1_000, usize::MAX) } else { (usize::MAX, 1_000) };
        for tag in 0..40 {
            if network.edge.as_ref().is_some_and(Connection::is_closed) {
                break;
            }
            network.send(Some(tag), &payload(4));
            network.steps(50);
            let answer = network.cloud.send(id, vec![payload(4).into()], Some(tag));
            if answer.is_err() {
                break;
            }
        }
        network.steps(3_000);
        let close_reason = network.events.iter().find_map(|event| match event {
            Event::Gone(reason) => Some(reason.as_str()),
            _ => None,
        });
        let reason = close_reason.expect("the connection ends");
        assert!(reason.contains("long datagrams") && reason.contains("datagram_bytes"), "{reason}");
        // The end whose long datagrams are lost ends the connection. A cloud tells the edge. An edge does not tell the
        // cloud, and this test ends before the heartbeat timeout of the cloud.
        let is_gone = |event: &ListenerEvent| matches!(event, ListenerEvent::Gone(..));
        assert_eq!(
            network.listener_events.iter().any(is_gone),
            !loses_upload,
            "{:?}",
            network.listener_events
        );
    }
}
