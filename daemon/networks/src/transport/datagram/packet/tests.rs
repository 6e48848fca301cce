//! Tests of the wire form: packets that are encoded and decoded, and arbitrary bytes.

use proptest::prelude::*;

use super::*;

/// Encodes and decodes a packet, and asserts that nothing changes. Returns its encoded length.
fn round_trip_bytes(from: Role, packet: Packet<'_>) -> usize {
    let to = if from == Role::Edge { Role::Cloud } else { Role::Edge };
    let mut wire = Vec::new();
    packet.write(from, &mut wire);
    assert_eq!(Packet::read(to, &wire), Ok(packet));
    assert_eq!(Packet::read(from, &wire), Err(InvalidPacket::WrongDirection));
    wire.len()
}

#[test]
fn encoded_packets_decode_to_same_packets() {
    let (nonce, connection, cookie) = (7, u64::MAX, [9; 16]);
    let terms = Terms { window: 1 << 20, max_datagram_bytes: 1_200 };
    let hello_bytes = round_trip_bytes(Role::Edge, Packet::Hello { version: 1, nonce, reply_port: 5_552 });
    let cookie_bytes = round_trip_bytes(Role::Cloud, Packet::Cookie { nonce, cookie });
    assert!(cookie_bytes <= hello_bytes, "no response is larger than its request");
    round_trip_bytes(Role::Edge, Packet::Open { nonce, cookie, reply_port: 0, terms });
    round_trip_bytes(Role::Cloud, Packet::Opened { nonce, connection, terms });
    let reset_bytes =
        round_trip_bytes(Role::Cloud, Packet::Reset { id: connection, reason: ResetReason::Full });
    for from in [Role::Edge, Role::Cloud] {
        let bytes = &[1, 2, 3][..];
        let fragment = Fragment {
            sequence: 5,
            tag: 6,
            offset: 8,
            total_bytes: 11,
            checksum: 12,
            stride: 4,
            lifetime_ms: 13,
            bytes,
        };
        let data_bytes = round_trip_bytes(from, Packet::Data { connection, number: 14, fragment });
        assert_eq!(data_bytes, DATA_HEADER_BYTES + bytes.len());
        round_trip_bytes(from, Packet::Progress { connection, sequence: 3, end: 4 });
        round_trip_bytes(from, Packet::Lost { connection, sequence: 3, received: 1, total: 2 });
        round_trip_bytes(from, Packet::LostAck { connection, sequence: 3, tag: 1, total: 2 });
        let arrivals = ArrivalTotals { lost: 5, duplicated: 6, reordered: 7 };
        let heartbeat = Heartbeat { time: 1, next: 2, settled: 3, number: 4, arrivals };
        let ping_bytes = round_trip_bytes(from, Packet::Ping { connection, heartbeat });
        round_trip_bytes(from, Packet::Pong { connection, heartbeat });
        let bye_bytes = round_trip_bytes(from, Packet::Bye { connection, next: 2 });
        let bye_ack_bytes = round_trip_bytes(from, Packet::ByeAck { connection });
        round_trip_bytes(from, Packet::PathChallenge { connection, token: 2 });
        round_trip_bytes(from, Packet::PathResponse { connection, token: 2 });
        // A reset answers a ping or data.
        assert!(bye_ack_bytes <= bye_bytes && reset_bytes <= ping_bytes && reset_bytes <= data_bytes);
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..80), kind in 0_u8..=16) {
        for role in [Role::Edge, Role::Cloud] {
            let _ = Packet::read(role, &bytes);
            let mut bytes_of_known_kind = bytes.clone();
            if let Some(first) = bytes_of_known_kind.first_mut() {
                *first = kind | if role == Role::Edge { FROM_CLOUD } else { 0 };
            }
            let _ = Packet::read(role, &bytes_of_known_kind);
        }
    }
}
