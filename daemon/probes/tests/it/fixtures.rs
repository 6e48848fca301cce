//! Tests that compare requests and replies of both modes with the files in `tests/fixtures/wire/probe`.
//!
//! Hosts of different versions probe each other. Therefore a reflector must answer a stored request with the stored
//! reply, and a sender must accept the stored reply as the answer to its request. `write_missing_fixtures` writes
//! missing files and never changes an existing file.

use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use peernet_clock::{Clock, ClockIdentity, ManualClock, RelatedClocks, Span, WallTime};
use peernet_probes::stamp::reflector::{Arrival, ReflectorState};
use peernet_probes::stamp::sender::{ReplyArrival, ReplyResult, SenderConfig, SenderState};

use crate::support::{INSTANCE, key};

/// Delay of each direction.
const ONE_WAY_DELAY: Span = Span::from_micros(700);
/// Time from the arrival of a request to its reply.
const REFLECTOR_DELAY: Span = Span::from_micros(50);

fn file(mode: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tests/fixtures/wire/probe/{name}.{mode}.bin"))
}

/// Requests and replies of two probes. The second reply reports when the first reply left the machine.
struct Conversation {
    requests: [Vec<u8>; 2],
    replies: [Vec<u8>; 2],
}

impl Conversation {
    const NAMES: [(&str, &str); 2] = [("request-1", "reply-1"), ("request-2", "reply-2")];

    /// Returns the packets with the names of their files.
    fn files(&self) -> impl Iterator<Item = (&'static str, &[u8])> {
        let pairs = Self::NAMES.into_iter().zip(self.requests.iter().zip(&self.replies));
        pairs.flat_map(|((request, reply), (request_packet, reply_packet))| {
            [(request, request_packet.as_slice()), (reply, reply_packet.as_slice())]
        })
    }

    fn read(mode: &str) -> Self {
        let read = |name: &str| {
            let path = file(mode, name);
            fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
        };
        Self {
            requests: Self::NAMES.map(|(request, _)| read(request)),
            replies: Self::NAMES.map(|(_, reply)| read(reply)),
        }
    }
}

/// Sends two probes. If `stored` is given, its packets arrive in place of those that were sent.
fn exchange(mode: &Mode, stored: Option<&Conversation>) -> (Conversation, Vec<ReplyResult>) {
    let key = mode.with_key.then(|| key(7));
    let edge = ManualClock::new(
        WallTime::from_unix_nanos(1_800_000_000_123_456_789),
        ClockIdentity::new("fixture", "edge"),
    );
    let mut sender = SenderState::new(SenderConfig {
        key: key.clone(),
        instance: Some(INSTANCE),
        with_nonce: mode.with_nonce,
        clocks: mode.clocks,
        ssid: 0xBEEF,
        first_sequence: 0x0102_0304,
        padding_bytes: 24,
        timeout: Span::from_seconds(1),
    });
    let mut reflector = ReflectorState::new(key, INSTANCE, 1000, true);
    let source: SocketAddr = "192.0.2.1:40000".parse().expect("an address");
    let mut conversation = Conversation { requests: Default::default(), replies: Default::default() };
    let mut reply_results = Vec::new();
    for number in 0..2 {
        let (departure, request) = sender.request_with_nonce(&edge, [0xA5; 16]);
        conversation.requests[number] = request.to_vec();
        sender.record_sent(departure);
        edge.advance(ONE_WAY_DELAY);

        // The reflector's free-running clock shows the same time as the edge's.
        let elapsed = edge.raw() - ManualClock::FIRST_RAW;
        let start = edge.wall() + Span::from_seconds(3) - elapsed;
        let cloud = ManualClock::new(start, ClockIdentity::new("fixture", "cloud"));
        cloud.advance(elapsed);
        let mut packet = stored.map_or(&conversation, |stored| stored).requests[number].clone();
        let (received, received_raw) = (cloud.wall(), cloud.raw());
        let arrival = Arrival { source, received, received_raw, now: edge.mono() };
        let answer = reflector.prepare(&mut packet, &arrival).expect("the request is answered");
        cloud.advance(REFLECTOR_DELAY);
        let stamp = reflector.complete(&answer, &mut packet, &cloud);
        reflector.record_sent(&answer, stamp);
        let departure = stamp + Span::from_micros(5);
        reflector.record_departure(&answer.session(), answer.sequence(), departure.wall, departure.raw);
        conversation.replies[number] = packet;

        edge.advance(REFLECTOR_DELAY + ONE_WAY_DELAY);
        let (ahead, epoch) = (edge.wall_ahead(), edge.epoch());
        let arrival = ReplyArrival { kernel: None, read: edge.stamp(), ahead, epoch };
        let reply = &stored.map_or(&conversation, |stored| stored).replies[number];
        reply_results.push(sender.receive(reply, &arrival).expect("the reply is accepted"));
        edge.advance(Span::from_millis(200));
    }
    (conversation, reply_results)
}

/// Mode of the packets.
struct Mode {
    name: &'static str,
    with_key: bool,
    clocks: RelatedClocks,
    /// `true` if octets tie an answer to its request. The octets are random in the program, and fixed in this test.
    with_nonce: bool,
}

impl Mode {
    const fn new(name: &'static str, with_key: bool, clocks: RelatedClocks) -> Self {
        Self { name, with_key, clocks, with_nonce: false }
    }
}

/// The first two modes are the modes of releases before 0.3.0.
const MODES: [Mode; 5] = [
    Mode::new("open", false, RelatedClocks::RawToWall),
    Mode::new("authenticated", true, RelatedClocks::RawToWall),
    Mode::new("open-raw", false, RelatedClocks::Raw),
    Mode::new("authenticated-raw", true, RelatedClocks::Raw),
    Mode { with_nonce: true, ..Mode::new("bound-raw", true, RelatedClocks::Raw) },
];

#[test]
#[ignore = "writes the files of new packets"]
fn write_missing_fixtures() {
    for mode in MODES {
        for (name, packet) in exchange(&mode, None).0.files() {
            let path = file(mode.name, name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("the folder can be made");
            if !path.exists() {
                fs::write(path, packet).expect("a fixture can be written");
            }
        }
    }
}

#[test]
fn stored_request_gets_stored_reply() {
    for mode in MODES {
        let mode_name = mode.name;
        let stored = Conversation::read(mode_name);
        let (current, reply_results) = exchange(&mode, Some(&stored));
        for ((name, packet), (_, stored_packet)) in current.files().zip(stored.files()) {
            assert!(
                packet == stored_packet,
                "{name}.{mode_name}: the bytes changed: {packet:02x?}, were {stored_packet:02x?}"
            );
        }
        let [first, second] = reply_results[..] else { panic!("two probes are answered: {reply_results:?}") };
        let exchanges =
            [first, second].map(|result| result.answered.expect("the clock was not set").exchange);
        for exchange in exchanges {
            assert_eq!(
                exchange.returned - exchange.sent,
                ONE_WAY_DELAY + REFLECTOR_DELAY + ONE_WAY_DELAY,
                "{mode_name}"
            );
            let start = WallTime::from_unix_nanos(1_800_000_000_123_456_789);
            let wall_ahead_at_start = Span::from_nanos(start.unix_nanos() - ManualClock::FIRST_RAW.nanos());
            let ahead = match mode.clocks {
                RelatedClocks::Raw => Span::ZERO,
                _ => wall_ahead_at_start + Span::from_seconds(3),
            };
            assert_eq!(exchange.received - exchange.sent, ONE_WAY_DELAY + ahead, "{mode_name}");
        }
        // The second reply reports when the first reply left the machine.
        let refined = second.refined.expect("the first exchange is refined").exchange;
        assert_eq!(refined.replied - exchanges[0].replied, Span::from_micros(5), "{mode_name}");
    }
}
