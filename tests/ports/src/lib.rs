//! Free ports for tests that start programs.

use std::net::{TcpListener, UdpSocket};
use std::sync::atomic::{AtomicU32, Ordering};

/// Ports outside of the range from which the system assigns ephemeral ports. While a program is stopped, no
/// connection of another process takes its port.
const PORTS: std::ops::Range<u32> = 10_000..32_000;

/// Returns a port of the loopback interface that is free for TCP and UDP; each call returns another one.
///
/// # Panics
/// If no port is free.
pub fn free_port() -> u16 {
    static TRIED_PORTS: AtomicU32 = AtomicU32::new(0);
    // Concurrent processes begin with different ports.
    let first = std::process::id().wrapping_mul(97);
    for _ in PORTS {
        let offset =
            first.wrapping_add(TRIED_PORTS.fetch_add(1, Ordering::Relaxed)) % (PORTS.end - PORTS.start);
        let port = u16::try_from(PORTS.start + offset).expect("the range ends below 65,536");
        let address = ("127.0.0.1", port);
        if TcpListener::bind(address).is_ok() && UdpSocket::bind(address).is_ok() {
            return port;
        }
    }
    panic!("no port between {} and {} is free", PORTS.start, PORTS.end);
}
