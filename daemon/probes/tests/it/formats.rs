//! Tests of the wire forms of stamps, packets and codes.

use std::os::unix::fs::PermissionsExt;

use peernet_clock::{Span, WallTime};
use peernet_probes::stamp::auth::Key;
use peernet_probes::stamp::packet::{self, Mode, Reply, Request};
use peernet_probes::stamp::timestamp::{ErrorEstimate, Format};
use peernet_probes::{KeyError, stamp::tlv};
use proptest::prelude::*;

use crate::support::key;

const SECOND: i64 = 1_000_000_000;

fn time_at(seconds: i64, nanos: i64) -> WallTime {
    WallTime::from_unix_nanos(seconds * SECOND + nanos)
}

#[test]
fn timestamps_have_the_standard_layout() {
    // 1970 in NTP's time, RFC 5905 figure 4.
    assert_eq!(Format::Ntp.encode(time_at(0, 0)), 2_208_988_800 << 32);
    assert_eq!(Format::Ntp.encode(time_at(0, SECOND / 2)), (2_208_988_800 << 32) | 1 << 31);
    assert_eq!(Format::Ptp.encode(time_at(5, 7)), (5 << 32) | 7);
    assert_eq!(Format::Ptp.decode((5 << 32) | 1_000_000_000, time_at(0, 0)), None, "no clock shows this");
}

#[test]
fn ntp_timestamps_are_exact_around_2036_rollover() {
    // NTP's second era begins on 2036-02-07 at 06:28:16 UTC.
    let rollover = 2_085_978_496;
    assert_eq!(Format::Ntp.encode(time_at(rollover, 0)), 0);
    assert_eq!(Format::Ntp.encode(time_at(rollover - 1, 0)) >> 32, u64::from(u32::MAX));
    for (reference_seconds, stamp) in
        [(-1, 1), (1, -1), (0, 0), (-86_400 * 365 * 60, 86_400 * 365 * 7), (SECOND, SECOND + 5)]
    {
        let (near, stamp) =
            (time_at(rollover + reference_seconds, 0), time_at(rollover + stamp, 123_456_789));
        assert_eq!(Format::Ntp.decode(Format::Ntp.encode(stamp), near), Some(stamp), "near {near:?}");
    }
}

#[test]
fn error_estimate_has_format_and_valid_multiplier() {
    let estimate = ErrorEstimate::new(Format::Ptp, Span::from_nanos(4));
    assert_eq!(estimate.format(), Format::Ptp);
    assert!(!estimate.is_synchronised(), "we do not claim UTC");
    assert_eq!(ErrorEstimate::new(Format::Ntp, Span::ZERO).bits(), 1, "a multiplier of zero is not allowed");
    let foreign = ErrorEstimate::from_bits(0b1100_0001_1111_1111);
    assert!(foreign.is_synchronised() && foreign.format() == Format::Ptp);
}

proptest! {
    #[test]
    fn encoded_timestamp_decodes_to_same_value(
        seconds in -1_000_000_000i64..4_000_000_000,
        nanos in 0..SECOND,
        distance in -2_000_000_000i64..2_000_000_000,
    ) {
        let time = time_at(seconds, nanos);
        let near = time_at(seconds + distance, 0);
        for format in [Format::Ntp, Format::Ptp] {
            prop_assert_eq!(format.decode(format.encode(time), near), Some(time));
        }
    }

    #[test]
    fn any_timestamp_is_converted_without_panic(bits: u64, near: i64) {
        for format in [Format::Ntp, Format::Ptp] {
            let _ = format.decode(bits, WallTime::from_unix_nanos(near));
            let _ = format.encode(WallTime::from_unix_nanos(near));
        }
    }

    #[test]
    fn encoded_error_estimate_covers_the_error(nanos in 0i64..1_000_000_000_000) {
        let error = Span::from_nanos(nanos);
        let estimate = ErrorEstimate::new(Format::Ntp, error);
        prop_assert!(estimate.error() + Span::from_nanos(1) >= error, "{} for {}", estimate.error().nanos(), nanos);
        prop_assert!(estimate.error().nanos() <= nanos + nanos / 100 + 1);
    }

    #[test]
    fn encoded_packets_decode_to_same_values(
        sequence: u32, timestamp: u64, bits: u16, ssid: u16,
        received: u64, reply_sequence: u32, reply_timestamp: u64, reply_bits: u16, ttl: u8,
    ) {
        for mode in [Mode::Unauthenticated, Mode::Authenticated] {
            let request = Request { sequence, timestamp, estimate: ErrorEstimate::from_bits(bits), ssid };
            let mut packet = vec![0xAA; mode.base_bytes()];
            request.write(mode, &mut packet);
            prop_assert_eq!(Request::parse(mode, &packet), Some(request));
            let estimate = ErrorEstimate::from_bits(reply_bits);
            let reply = Reply {
                sequence: reply_sequence,
                timestamp: reply_timestamp,
                estimate,
                received,
                request,
                ttl,
            };
            reply.write(mode, &mut packet);
            prop_assert_eq!(Reply::parse(mode, &packet), Some(reply));
            prop_assert_eq!(Reply::parse(mode, &packet[..mode.base_bytes() - 1]), None);
        }
    }
}

#[test]
fn fields_have_the_layout_of_the_rfcs() {
    let request = Request {
        sequence: 0x0102_0304,
        timestamp: 0x1112_1314_1516_1718,
        estimate: ErrorEstimate::from_bits(0x2122),
        ssid: 0x3132,
    };
    let reply = Reply {
        sequence: 0x4142_4344,
        timestamp: 0x5152_5354_5556_5758,
        estimate: ErrorEstimate::from_bits(0x6162),
        received: 0x7172_7374_7576_7778,
        request,
        ttl: 0x81,
    };
    let mut unauthenticated = [0xEE; 44];
    reply.write(Mode::Unauthenticated, &mut unauthenticated);
    #[rustfmt::skip]
    let expected = [
        0x41, 0x42, 0x43, 0x44,
        0x51, 0x52, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58,
        0x61, 0x62, 0x31, 0x32,
        0x71, 0x72, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78,
        0x01, 0x02, 0x03, 0x04,
        0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18,
        0x21, 0x22, 0x00, 0x00,
        0x81, 0x00, 0x00, 0x00,
    ];
    assert_eq!(unauthenticated, expected);

    let mut authenticated = [0xEE; 112];
    reply.write(Mode::Authenticated, &mut authenticated);
    for (range, byte) in
        [(0..4, 0x41), (16..24, 0x51), (24..26, 0x61), (26..28, 0x31), (32..40, 0x71), (48..52, 0x01)]
            .into_iter()
            .chain([(64..72, 0x11), (72..74, 0x21), (80..81, 0x81)])
    {
        let expected: Vec<u8> = range.clone().zip(byte..).map(|(_, byte)| byte).collect();
        assert_eq!(authenticated[range.clone()], expected[..], "{range:?}");
    }
    for range in [4..16, 28..32, 40..48, 52..64, 74..80, 81..112] {
        assert!(authenticated[range.clone()].iter().all(|byte| *byte == 0), "{range:?} must be zero");
    }
}

#[test]
fn code_is_hmac_sha_256_cut_to_16_bytes() {
    // Test case 1 of RFC 4231.
    let key = Key::from_bytes(&[0x0b; 20]);
    let code =
        [0xb0, 0x34, 0x4c, 0x61, 0xd8, 0xdb, 0x38, 0x53, 0x5c, 0xa8, 0xaf, 0xce, 0xaf, 0x0b, 0xf1, 0x2b];
    assert_eq!(key.code(&[b"Hi ", b"There"]), code);
    assert!(key.verifies(&[b"Hi There"], &code));
    assert!(!key.verifies(&[b"Hi There"], &code[..15]), "a shorter code proves less");
    // Each byte of the key is 11 in decimal.
    assert!(!format!("{key:?}").contains("11"), "a key is never printed: {key:?}");
}

#[test]
fn altered_base_packet_is_refused() {
    let mut packet = [3; 112];
    packet::authenticate(&key(7), &mut packet);
    assert!(packet::is_authentic(&key(7), &packet));
    assert!(!packet::is_authentic(&key(8), &packet));
    for index in 0..packet.len() {
        packet[index] ^= 0x10;
        assert!(!packet::is_authentic(&key(7), &packet), "byte {index}");
        packet[index] ^= 0x10;
    }
    assert!(!packet::is_authentic(&key(7), &packet[..111]));
}

#[test]
fn tlv_iteration_ends_where_no_tlv_can_begin() {
    let kinds =
        |bytes: &[u8]| tlv::headers(bytes).map(|header| (header.kind, header.overruns)).collect::<Vec<_>>();
    assert_eq!(kinds(&[]), []);
    assert_eq!(kinds(&[0x80, 1, 0, 1, 9, 0x80, 7, 0, 0, 0x80, 7]), [(1, false), (7, false)]);
    assert_eq!(kinds(&[0x80, 1, 0, 9, 9, 0x80, 7, 0, 0]), [(1, true)]);
    assert_eq!(kinds(&[0; 64]), [], "the padding of TWAMP-light");
}

#[test]
fn key_is_read_from_private_file_only() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("probes.key");
    let write = |text: &str, mode| {
        std::fs::write(&path, text).expect("written");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("own file");
        Key::read(&path)
    };
    let valid_text = "07".repeat(32) + "\n";
    let parsed_key = write(&valid_text, 0o600).expect("a key");
    assert_eq!(parsed_key.code(&[b"x"]), key(7).code(&[b"x"]));
    assert!(write(&valid_text.to_uppercase(), 0o400).is_ok());

    let error = write(&valid_text, 0o640).expect_err("open to others");
    assert!(
        matches!(error, KeyError::OpenToOthers { .. }) && error.to_string().contains("chmod 0600"),
        "{error}"
    );
    let too_long_text = "07".repeat(4_000);
    for (text, problem) in [
        ("07", "too short"),
        ("zz", "not hexadecimal"),
        ("077", "odd number"),
        ("", "too short"),
        (&too_long_text, "too long"),
    ] {
        let error = write(text, 0o600).expect_err(problem).to_string();
        assert!(error.contains(problem) && error.contains("openssl rand -hex 32"), "{error}");
    }
    std::fs::remove_file(&path).expect("removed");
    let error = Key::read(&path).expect_err("gone");
    assert!(matches!(error, KeyError::Read { .. }) && error.to_string().contains("probes.key"), "{error}");
}
