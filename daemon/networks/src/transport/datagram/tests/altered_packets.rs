//! Tests with altered or forged packets. A packet that is altered as in one of the [`CASES`] affects no later message
//! and changes no total by more than one. An arbitrary altered bit loses at most one later message.

use super::*;

/// A number far above everything that is sent in these tests.
const FAR_AHEAD: u64 = 1 << 20;

/// Alters a packet of one kind. Returns `None` for packets of other kinds.
type Alteration = for<'a> fn(Packet<'a>) -> Option<Packet<'a>>;

/// Name of an alteration, and the alteration.
type Case = (&'static str, Alteration);

fn alter_heartbeat(packet: Packet<'_>, alter: fn(&mut Heartbeat)) -> Option<Packet<'_>> {
    match packet {
        Packet::Ping { connection, mut heartbeat } => {
            alter(&mut heartbeat);
            Some(Packet::Ping { connection, heartbeat })
        }
        Packet::Pong { connection, mut heartbeat } => {
            alter(&mut heartbeat);
            Some(Packet::Pong { connection, heartbeat })
        }
        _ => None,
    }
}

/// Increases the numbers of the message and of the datagram.
fn alter_data(packet: Packet<'_>, sequence_increase: u64, number_increase: u32) -> Option<Packet<'_>> {
    let Packet::Data { connection, number, mut fragment } = packet else { return None };
    fragment.sequence += sequence_increase;
    Some(Packet::Data { connection, number: number.wrapping_add(number_increase), fragment })
}

const CASES: [Case; 13] = [
    ("next message far ahead", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.next += FAR_AHEAD)),
    ("next message within the window", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.next += 500)),
    ("settled message far ahead", |packet| {
        alter_heartbeat(packet, |heartbeat| heartbeat.settled += FAR_AHEAD)
    }),
    ("settled message ahead", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.settled += 2)),
    ("next datagram far ahead", |packet| {
        alter_heartbeat(packet, |heartbeat| heartbeat.number += FAR_AHEAD as u32)
    }),
    ("lost datagrams", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.arrivals.lost = u64::MAX)),
    ("duplicated datagrams", |packet| {
        alter_heartbeat(packet, |heartbeat| heartbeat.arrivals.duplicated |= 1 << 40)
    }),
    ("reordered datagrams", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.arrivals.reordered += 3)),
    ("time", |packet| alter_heartbeat(packet, |heartbeat| heartbeat.time ^= 1 << 22)),
    ("fragment far ahead", |packet| alter_data(packet, FAR_AHEAD, 0)),
    ("fragment ahead", |packet| alter_data(packet, 500, 0)),
    ("datagram far ahead", |packet| alter_data(packet, 0, FAR_AHEAD as u32)),
    ("datagram half of all numbers ahead", |packet| alter_data(packet, 0, i32::MAX as u32)),
];

impl SimulatedNetwork {
    /// Alters the next packet in one direction that is of the alteration's kind.
    fn alter_next(&mut self, is_to_cloud: bool, alter: Alteration) {
        let (receiver, sender) =
            if is_to_cloud { (Role::Cloud, Role::Edge) } else { (Role::Edge, Role::Cloud) };
        for _ in 0..5_000 {
            for (to_cloud, _, datagram) in self.path.datagrams.values_mut() {
                let body = datagram.strip_prefix(PREFIX).expect("has the prefix");
                if *to_cloud == is_to_cloud
                    && let Some(packet) = alter(Packet::read(receiver, body).expect("a packet"))
                {
                    let mut altered = PREFIX.to_vec();
                    packet.write(sender, &mut altered);
                    *datagram = altered;
                    return;
                }
            }
            self.step();
        }
        panic!("no such packet is sent");
    }

    /// Exchanges a message in each direction. Returns whether both arrive.
    fn exchange(&mut self, id: ConnectionId, tag: u64) -> bool {
        self.listener_events.clear();
        self.events.clear();
        let (upload, download) = (tag.to_be_bytes(), (!tag).to_be_bytes());
        self.send(Some(tag), &upload);
        let sent = self.cloud.send(id, vec![Bytes::copy_from_slice(&download)], Some(tag));
        self.steps(30);
        let is_upload = |event: &ListenerEvent| matches!(event, ListenerEvent::Message(_, frames) if frames[0] == upload[..]);
        let is_download =
            |event: &Event| matches!(event, Event::Message(frames, _) if frames[0] == download[..]);
        sent.is_ok() && self.listener_events.iter().any(is_upload) && self.events.iter().any(is_download)
    }
}

/// Returns an open connection over which some messages were exchanged.
fn open() -> (SimulatedNetwork, ConnectionId) {
    let mut network = SimulatedNetwork::new(UNIMPAIRED, 1);
    let id = network.open();
    for tag in 0..20 {
        assert!(network.exchange(id, tag));
    }
    (network, id)
}

#[test]
fn single_altered_packet_harms_no_later_message() {
    for (name, alter) in CASES {
        for is_to_cloud in [true, false] {
            let (mut network, id) = open();
            // The message in flight may be lost with the altered packet.
            network.send(Some(90), b"up");
            network.cloud.send(id, vec!["down".into()], Some(90)).expect("there is room");
            network.alter_next(is_to_cloud, alter);
            // Longer than any timeout, with heartbeats in between.
            network.steps(6_000);
            for tag in 100..130 {
                assert!(
                    network.exchange(id, tag),
                    "{name}, to the cloud: {is_to_cloud}, {tag}: {:?}",
                    network.events
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn any_altered_bit_loses_at_most_one_later_message(
        millis in 0_u64..200,
        datagram_index: prop::sample::Index,
        bit: prop::sample::Index,
        loss in 0_u64..10,
        seed: u64,
    ) {
        let impairment = Impairment { loss, duplicated: 3, reordered: 10 };
        let mut network = SimulatedNetwork::new(impairment, seed);
        let id = network.open();
        for tag in 0..20 {
            network.send(Some(tag), &payload(tag % 5));
            network.cloud.send(id, vec![payload(tag % 5).into()], Some(tag)).expect("there is room");
            network.steps(millis / 10);
        }
        let mut steps = 0;
        while network.path.datagrams.is_empty() && steps < 5_000 {
            network.step();
            steps += 1;
        }
        let datagram_count = network.path.datagrams.len();
        let datagram = network.path.datagrams.values_mut().nth(datagram_index.index(datagram_count)).expect("a datagram in flight");
        let bit = 8 * PREFIX.len() + bit.index(8 * (datagram.2.len() - PREFIX.len()));
        datagram.2[bit / 8] ^= 1 << (bit % 8);
        network.path.impairment = UNIMPAIRED;
        network.steps(8_000);
        let lost: Vec<u64> = (100..130).filter(|tag| !network.exchange(id, *tag)).collect();
        // A message whose number was altered takes the place of a later message.
        prop_assert!(lost.len() <= 1, "{:?}: {:?}", lost, network.events);
        let now = network.now;
        let edge = network.edge.as_mut().expect("the connection is open").statistics(now);
        let cloud = network.cloud.statistics(id, now);
        for direction in [edge.sent, edge.received, cloud.sent, cloud.received] {
            // At most the losses of the path and the numbers that one altered number skips.
            prop_assert!(direction.lost < Some(200) && direction.reordered < Some(300), "{:?}", direction);
        }
    }
}

#[test]
fn single_altered_packet_barely_changes_totals() {
    for (name, alter) in CASES {
        for is_to_cloud in [true, false] {
            let (mut network, id) = open();
            network.send(Some(90), b"up");
            network.cloud.send(id, vec!["down".into()], Some(90)).expect("there is room");
            network.alter_next(is_to_cloud, alter);
            network.steps(6_000);
            let now = network.now;
            let edge = network.edge.as_mut().expect("the connection is open").statistics(now);
            let cloud = network.cloud.statistics(id, now);
            for direction in [edge.sent, edge.received, cloud.sent, cloud.received] {
                let [lost, duplicated, reordered] =
                    [direction.lost, direction.duplicated, direction.reordered]
                        .map(|total| total.expect("a second report has arrived"));
                assert!(
                    lost <= 1 && duplicated == 0 && reordered <= 1,
                    "{name}, {is_to_cloud}: {direction:?}"
                );
            }
            for trip in [edge.round_trip, cloud.round_trip] {
                let trip = trip.expect("a heartbeat was answered");
                assert_eq!(trip.min, Some(Span::from_millis(10)), "{name}, {is_to_cloud}: {trip:?}");
                assert!(trip.smoothed <= Span::from_millis(12), "{name}, {is_to_cloud}: {trip:?}");
            }
        }
    }
}

#[test]
fn reports_of_unsent_messages_are_invalid_data() {
    let (mut network, id) = open();
    let connection = id.0;
    let forged = [
        // A report about the last message that was sent, which has one fragment.
        Packet::Lost { connection, sequence: 19, received: 9, total: 9 },
        Packet::Lost { connection, sequence: FAR_AHEAD, received: 0, total: 0 },
        Packet::Progress { connection, sequence: FAR_AHEAD, end: 1 },
        Packet::Ping {
            connection,
            heartbeat: Heartbeat { next: FAR_AHEAD, time: 1, ..Heartbeat::default() },
        },
        Packet::Ping {
            connection,
            heartbeat: Heartbeat { settled: FAR_AHEAD, time: 2, ..Heartbeat::default() },
        },
    ];
    for packet in forged {
        network.listener_events.clear();
        let mut body = Vec::new();
        packet.write(Role::Edge, &mut body);
        network.cloud.receive(network.edge_address, None, &body, network.now);
        network.steps(1);
        let is_invalid = |event: &&ListenerEvent| matches!(event, ListenerEvent::InvalidData(Some(_), _));
        assert_eq!(network.listener_events.iter().filter(is_invalid).count(), 1, "{packet:?}");
        assert!(network.exchange(id, 200), "{packet:?}");
    }
}

#[test]
fn three_seconds_of_loss_do_not_end_connection() {
    let (mut network, id) = open();
    network.path.impairment.loss = 100;
    let mut sent = 0;
    for _ in 0..3_000 {
        let edge = network.edge.as_mut().expect("the connection is open");
        sent += u32::from(edge.send(vec![Bytes::from_static(&[7; 100])], Some(sent.into()), None).is_ok());
        network.step();
    }
    assert!(sent > 2_000, "{sent} messages were sent while the path lost all datagrams");
    network.path.impairment.loss = 0;
    network.steps(2_000);
    for tag in 10_000..10_010 {
        assert!(network.exchange(id, tag), "{:?}", network.events);
    }
}

#[test]
fn contradicting_ends_close_the_connection() {
    for jump in [FAR_AHEAD, 500] {
        let (mut network, id) = open();
        // Two successive claims that agree are believed. The cloud then treats messages that are still to be sent as
        // lost.
        for time in 1..3 {
            let heartbeat = Heartbeat { time, next: 20 + jump, ..Heartbeat::default() };
            let mut body = Vec::new();
            Packet::Ping { connection: id.0, heartbeat }.write(Role::Edge, &mut body);
            network.cloud.receive(network.edge_address, None, &body, network.now);
        }
        network.steps(20_000);
        let reason = network.events.iter().find_map(|event| match event {
            Event::Gone(reason) => Some(reason.as_str()),
            _ => None,
        });
        assert!(reason.is_some_and(|reason| reason.contains("altered or forged")), "{:?}", network.events);
    }
}
