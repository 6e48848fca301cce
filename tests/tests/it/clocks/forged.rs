//! Tests with an attacker on the path who reads and alters probes, but not the session.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use peernet_clock::Span;
use peernet_tests::network::{Host, Network, WireProperties};
use peernet_tests::truth::HostClock;
use peernet_tests::{ClockShim, TwoHostTestbed, wait_until_grown};

use super::{CONSTANT_DRIFT, assert_contains_truth};

/// Port of the reflector.
const REFLECTOR_PORT: u16 = 8620;
/// Port to which the attacker redirects the edge's probes.
const FORGER_PORT: u16 = 9620;
/// Port from which the attacker forwards the probes to the cloud.
const FORWARDER_PORT: u16 = 9621;

/// Error that is added to the cloud's stamps. It is smaller than the uncertainty of the offset after a round trip of 40 ms.
const ADDED_ERROR: Span = Span::from_millis(13);

/// Attacker between the edge and the path.
struct Forger {
    is_over: Arc<AtomicBool>,
    forged: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl Forger {
    /// Redirects all probes that leave the edge for a cloud.
    fn start(edge: &Host, cloud: Ipv4Addr) -> Self {
        edge.run("nft", &["add", "table", "ip", "forger"]);
        let add_chain = ["add", "chain", "ip", "forger", "out"];
        edge.run("nft", &[&add_chain[..], &["{ type nat hook output priority -100 ; }"]].concat());
        let (probes, forwarded, forger) =
            (REFLECTOR_PORT.to_string(), FORWARDER_PORT.to_string(), format!(":{FORGER_PORT}"));
        let rule = ["udp", "dport", &probes, "udp", "sport", "!=", &forwarded, "redirect", "to", &forger];
        edge.run("nft", &[&["add", "rule", "ip", "forger", "out"], &rule[..]].concat());
        let (near, far) = edge.run_in_namespace(|| {
            let socket = |address, port| {
                let socket = UdpSocket::bind((address, port)).expect("a port of its own");
                socket.set_read_timeout(Some(Duration::from_millis(1))).expect("a millisecond is a timeout");
                socket
            };
            // Redirected packets arrive at this address, and answers must leave from it.
            (socket(Ipv4Addr::LOCALHOST, FORGER_PORT), socket(Ipv4Addr::UNSPECIFIED, FORWARDER_PORT))
        });
        let (is_over, forged) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let relay = Relay { near, far, cloud: (cloud, REFLECTOR_PORT).into(), edge: None };
        let thread = std::thread::spawn({
            let (is_over, forged) = (Arc::clone(&is_over), Arc::clone(&forged));
            move || relay.run(&is_over, &forged)
        });
        Self { is_over, forged, thread: Some(thread) }
    }

    fn forged_answers(&self) -> usize {
        self.forged.load(Ordering::Relaxed)
    }
}

impl Drop for Forger {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join)
            && !std::thread::panicking()
        {
            std::panic::resume_unwind(panic);
        }
    }
}

/// Forwards probes and alters each answer.
struct Relay {
    /// Socket towards the edge.
    near: UdpSocket,
    /// Socket towards the cloud.
    far: UdpSocket,
    cloud: SocketAddr,
    edge: Option<SocketAddr>,
}

impl Relay {
    fn run(mut self, is_over: &AtomicBool, forged: &AtomicUsize) {
        let mut buffer = [0; 2048];
        while !is_over.load(Ordering::Relaxed) {
            if let Some((length, from)) = receive(&self.near, &mut buffer) {
                self.edge = Some(from);
                self.far.send_to(&buffer[..length], self.cloud).expect("there is a route");
            }
            if let Some((length, _)) = receive(&self.far, &mut buffer) {
                forge(&mut buffer[..length]);
                forged.fetch_add(1, Ordering::Relaxed);
                let edge = self.edge.expect("a probe came first");
                self.near.send_to(&buffer[..length], edge).expect("there is a route");
            }
        }
    }
}

/// Receives a packet; returns `None` if nothing arrives in a millisecond, or if the other end has no listener.
fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
    match socket.recv_from(buffer) {
        Ok(received) => Some(received),
        Err(error) => {
            let expected_errors = [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::ConnectionRefused];
            assert!(expected_errors.contains(&error.kind()), "{error}");
            None
        }
    }
}

/// Shifts the cloud's clocks by [`ADDED_ERROR`], in both layouts of a base packet and in the stamps of its free-running
/// clock.
fn forge(answer: &mut [u8]) {
    let ntp = (ADDED_ERROR.nanos() << 32) / 1_000_000_000;
    // These bytes are a stamp in an unauthenticated packet, and zeros in an authenticated packet.
    let is_unauthenticated = answer[4..12] != [0; 8];
    for offset in if is_unauthenticated { [4, 16] } else { [16, 32] } {
        let stamp: [u8; 8] = answer[offset..offset + 8].try_into().expect("eight bytes");
        answer[offset..offset + 8]
            .copy_from_slice(&u64::from_be_bytes(stamp).wrapping_add_signed(ntp).to_be_bytes());
    }
    let raw_stamps =
        answer.windows(4).position(|bytes| bytes == b"PRAW").expect("stamps of the free-running clock");
    // The mark and an epoch precede the stamps of arrival and departure.
    for offset in [raw_stamps + 8, raw_stamps + 16] {
        let stamp: [u8; 8] = answer[offset..offset + 8].try_into().expect("eight bytes");
        answer[offset..offset + 8]
            .copy_from_slice(&(i64::from_be_bytes(stamp) + ADDED_ERROR.nanos()).to_be_bytes());
    }
}

/// Runs a case with at least this number of forged answers.
fn check_forged_answers(min_forged_answers: u64) {
    let wire_direction = WireProperties { delay_ms: 20, jitter_ms: 0, loss_percent: 0 };
    let testbed = TwoHostTestbed::new(|folder| Network::wire(folder, wire_direction, wire_direction));
    let shim = ClockShim::new(&testbed.folder().join("edge-clocks"));
    shim.schedule_change(Span::from_seconds(2), 60.0, CONSTANT_DRIFT);
    let forger = Forger::start(testbed.network.edge(), testbed.network.cloud().address);
    let _cloud = testbed.start_cloud("[clock]\ndiscipline = []\n");
    let clock = "clock_identity = \"edge\"\n[clock]\ntimestamps = \"user\"\ndiscipline = []\n";
    let load = "load = { mode = \"rate\", hz = 50.0 }\nmax_in_flight = 64";
    let edge = testbed
        .start_edge(&format!("{clock}{}", testbed.pipeline("watched", 1000, load)), &shim.environment());
    wait_until_grown("forged answers", min_forged_answers, || Some(forger.forged_answers() as u64));
    testbed.api.wait_until("/api/v1/links/edge~cloud", |link| {
        link.to_string().contains("not authenticated by the key").then_some(())
    });
    assert_eq!(edge.stop().code(), 0);
    testbed.api.wait_until("/api/v1/runs", |runs| (runs["runs"][0]["reason"] == "stopped").then_some(()));

    let (edge_clock, cloud_clock) = (HostClock::with_shim_errors(shim.errors()), HostClock::of_kernel());
    let case = "all answers to probes forged by 13 ms, 20/20 ms";
    let (up, down) = assert_contains_truth(case, &testbed.iterations(), &edge_clock, &cloud_clock);
    for comparison in [&up, &down] {
        assert!(comparison.without_value.is_empty(), "{:?}", comparison.without_value);
        assert!(comparison.compared > 500, "{}", comparison.summary());
    }
    let probes =
        testbed.query_database("SELECT sum(probes_sent) > 20, sum(probes_answered) FROM clock_sample");
    assert_eq!(probes.trim(), "1|0", "no forged answer counts");
}

#[test]
fn intervals_are_right_with_forged_probe_answers() {
    check_forged_answers(150);
}

#[test]
#[ignore = "takes ten minutes; for make soak"]
fn intervals_are_right_during_ten_minute_forgery() {
    check_forged_answers(6_000);
}
