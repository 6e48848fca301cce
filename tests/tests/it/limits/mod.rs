//! Tests of the limits before authentication, with real daemons.

mod connections;
mod memory;
mod probes;
mod ros;
mod sessions;
mod slow_readers;
mod unknown_host;

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use peernet_tests::{Process, TEST_TIMEOUT};

/// Peer that sends what a test determines, with or without the handshake of ZMTP 3.1.
struct Peer(TcpStream);

impl Peer {
    /// Connects and sends nothing.
    fn connect(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("the port is open");
        stream.set_read_timeout(Some(TEST_TIMEOUT)).expect("a socket takes a timeout");
        stream.set_write_timeout(Some(TEST_TIMEOUT)).expect("a socket takes a timeout");
        Self(stream)
    }

    /// Connects and completes the handshake; a listener may have closed the connection meanwhile.
    fn connect_with_handshake(port: u16) -> Self {
        let mut greeting = vec![0xff, 0, 0, 0, 0, 0, 0, 0, 1, 0x7f, 3, 1];
        greeting.extend_from_slice(b"NULL");
        greeting.resize(64, 0);
        greeting.extend_from_slice(b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER");
        let mut peer = Self::connect(port);
        if peer.0.write_all(&greeting).is_ok() {
            // The other side sends READY after it has processed our greeting. The 66 bytes are its own greeting and the
            // first two bytes of READY.
            let _closed = peer.0.read_exact(&mut [0; 66]);
        }
        peer
    }

    /// Sends a frame whose header announces one byte more than follows. Returns the number of bytes that were sent before
    /// the connection was closed.
    fn send_unfinished(&mut self, bytes: usize) -> usize {
        // 2 is the flag of a frame whose size has eight bytes.
        let header = [&[2][..], &(bytes as u64 + 1).to_be_bytes()].concat();
        if self.0.write_all(&header).is_err() {
            return 0;
        }
        let chunk = vec![7; 100_000];
        let is_sent = |_: &usize| self.0.write_all(&chunk).is_ok();
        (0..bytes / chunk.len()).take_while(is_sent).count() * chunk.len()
    }

    /// Returns whether the other side has closed the connection.
    fn is_closed(&mut self) -> bool {
        self.0.set_read_timeout(Some(Duration::from_millis(1))).expect("a socket takes a timeout");
        let mut buffer = [0; 256];
        loop {
            match self.0.read(&mut buffer) {
                Ok(0) => return true,
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return false;
                }
                Err(_) => return true,
            }
        }
    }
}

/// Returns the peak memory of a process, bytes.
fn peak_memory(process: &Process) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.pid())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("the kernel reports VmHWM");
    let kib: u64 = line.trim().trim_end_matches(" kB").parse().expect("a number");
    kib * 1024
}
