//! Free ports for tests that start programs.

use std::net::{TcpListener, UdpSocket};
use std::sync::atomic::{AtomicU32, Ordering};

/// Ports that the system gives to nobody who does not ask for them: while a program is away, no connection of another
/// process gets its port by chance.
const PORTS: std::ops::Range<u32> = 10_000..32_000;

/// A port of loopback that nobody has at the moment, of TCP and of UDP, and another at each call.
///
/// # Panics
/// When all are taken.
pub fn free_port() -> u16 {
    static TAKEN: AtomicU32 = AtomicU32::new(0);
    let first = std::process::id().wrapping_mul(97);
    for _ in PORTS {
        let at = first.wrapping_add(TAKEN.fetch_add(1, Ordering::Relaxed)) % (PORTS.end - PORTS.start);
        let port = u16::try_from(PORTS.start + at).expect("the range ends below 65,536");
        let place = ("127.0.0.1", port);
        if TcpListener::bind(place).is_ok() && UdpSocket::bind(place).is_ok() {
            return port;
        }
    }
    panic!("no port between {} and {} is free", PORTS.start, PORTS.end);
}
