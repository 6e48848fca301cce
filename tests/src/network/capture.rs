//! Capture of the packets that pass a host, with the kernel's timestamps.

use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};

use peernet_clock::WallTime;
use rustix::process::Signal;

use super::Host;
use crate::{Process, wait_until};

/// Loopback address of the packet that marks the end of a capture. No other program sends to it.
const END_MARKER: Ipv4Addr = Ipv4Addr::new(127, 62, 0, 1);

/// A running capture.
#[derive(Debug)]
pub struct Capture {
    tcpdump: Process,
    file: PathBuf,
    marker: UdpSocket,
}

/// IPv4 packet that entered or left a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Time according to the kernel's wall clock.
    pub at: WallTime,
    /// `true` if it left the host; a forwarded packet is captured twice.
    pub is_outgoing: bool,
    /// Source address.
    pub source: Ipv4Addr,
    /// Destination address.
    pub destination: Ipv4Addr,
    /// Number of bytes after the TCP header; 0 for other protocols.
    pub payload: usize,
}

impl Capture {
    /// Number of captured bytes per packet: enough for the headers of all layers.
    const SNAPSHOT_LENGTH: &str = "120";

    pub(super) fn start(host: &Host, filter: &str, folder: &Path) -> Self {
        let file = folder.join(format!("{}.pcap", host.namespace));
        let path = file.display().to_string();
        let filter = format!("({filter}) or (host {END_MARKER} and udp)");
        let format = ["--interface", "any", "--linktype", "LINUX_SLL2", "--time-stamp-precision", "nano"];
        let buffers =
            ["--snapshot-length", Self::SNAPSHOT_LENGTH, "--buffer-size", "32768", "--immediate-mode", "-U"];
        let output = ["-Z", "root", "-n", "-w", &path, &filter];
        let arguments = [&format[..], &buffers, &output].concat();
        let tcpdump = host.start(Path::new("tcpdump"), &arguments, folder, &[]);
        tcpdump.wait_for("listening on");
        Self {
            tcpdump,
            file,
            marker: host.run_in_namespace(|| UdpSocket::bind((END_MARKER, 0)).expect("loopback is up")),
        }
    }

    /// Ends the capture; returns the packets in the order of time.
    ///
    /// # Panics
    /// If the kernel dropped packets because tcpdump was too slow, or if the file is invalid.
    pub fn finish(self) -> Vec<Packet> {
        // tcpdump lags behind: when it has written a packet that is sent now, it has written all earlier packets.
        let address = self.marker.local_addr().expect("a bound socket has an address");
        self.marker.send_to(&[], address).expect("loopback is up");
        let mut packets = wait_until("the end of the capture", || {
            let packets = parse_packets(&std::fs::read(&self.file).ok()?)?;
            packets.iter().any(|packet| packet.destination == END_MARKER).then_some(packets)
        });
        self.tcpdump.signal(Signal::INT);
        let end = self.tcpdump.wait_for_end();
        assert!(end.log.contains("\n0 packets dropped by kernel"), "the capture is incomplete: {}", end.log);
        packets.retain(|packet| packet.destination != END_MARKER);
        packets.sort_by_key(|packet| packet.at);
        packets
    }
}

/// Parses a capture file (draft-ietf-opsawg-pcap) with nanoseconds and link type 276, LINUX_SLL2; returns `None`
/// while it is incomplete.
fn parse_packets(file: &[u8]) -> Option<Vec<Packet>> {
    const NANOSECONDS: u32 = 0xa1b2_3c4d;
    const LINUX_SLL2: u32 = 276;
    let word = |offset: usize| Some(u32::from_le_bytes(file.get(offset..offset + 4)?.try_into().ok()?));
    if (word(0)?, word(20)?) != (NANOSECONDS, LINUX_SLL2) {
        return None;
    }
    let (mut offset, mut packets) = (24, Vec::new());
    while offset < file.len() {
        let (seconds, nanos, length) = (word(offset)?, word(offset + 4)?, word(offset + 8)? as usize);
        let stamp = WallTime::from_unix_nanos(i64::from(seconds) * 1_000_000_000 + i64::from(nanos));
        packets.extend(parse_packet(stamp, file.get(offset + 16..offset + 16 + length)?));
        offset += 16 + length;
    }
    Some(packets)
}

/// Parses one packet with its LINUX_SLL2 header; returns `None` for other protocols than IPv4.
fn parse_packet(at: WallTime, bytes: &[u8]) -> Option<Packet> {
    const OUTGOING: u8 = 4;
    const TCP: u8 = 6;
    let (sll, ip) = bytes.split_at_checked(20)?;
    if sll.get(..2)? != [0x08, 0x00] {
        return None;
    }
    let address = |offset: usize| Some(Ipv4Addr::from_octets(ip.get(offset..offset + 4)?.try_into().ok()?));
    let header = usize::from(ip.first()? & 0x0f) * 4;
    let total = usize::from(u16::from_be_bytes(ip.get(2..4)?.try_into().ok()?));
    let payload = match ip.get(9)? {
        &TCP => total.saturating_sub(header + usize::from(ip.get(header + 12)? >> 4) * 4),
        _ => 0,
    };
    let is_outgoing = *sll.get(10)? == OUTGOING;
    Some(Packet { at, is_outgoing, source: address(12)?, destination: address(16)?, payload })
}
