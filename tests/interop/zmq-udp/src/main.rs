//! A relay between an edge and a cloud of `zmq-udp` that reads and writes with a real RADIO and DISH of libzmq in both
//! directions. Prints the port that the edge is to send to, and runs until it is killed or something is wrong.
//!
//! Usage: `peernet-interop-zmq-udp CLOUD` (address and port on loopback)

mod libzmq;

use std::net::{SocketAddr, UdpSocket};

use anyhow::{Context as _, Result, ensure};
use libzmq::{Context, Socket};
use socket2::{Domain, Type};

/// The group of all datagrams.
const GROUP: &str = "peernet";

/// Where a hello and a request for a connection name the port of the edge's DISH.
const REPLY_PORTS: [(u8, usize); 2] = [(1, 10), (3, 25)];

/// A port that nobody has.
fn free_port() -> Result<u16> {
    Ok(UdpSocket::bind("127.0.0.1:0")?.local_addr()?.port())
}

/// Passes everything that a DISH receives on to a RADIO; returns why it cannot any more.
fn pass(from: &Socket, to: &Socket, change: impl Fn(&mut Vec<u8>)) -> Result<()> {
    loop {
        let (group, mut body) = from.receive()?;
        ensure!(group == GROUP, "a message of the group {group}");
        change(&mut body);
        to.send(&group, &body)?;
    }
}

fn main() -> Result<()> {
    let cloud: SocketAddr = std::env::args().nth(1).context("no address of a cloud")?.parse()?;
    // The DISH takes the port while this socket has it, so that nobody finds it closed.
    let front = socket2::Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    front.set_reuse_address(true)?;
    front.bind(&SocketAddr::from(([127, 0, 0, 1], 0)).into())?;
    let front = UdpSocket::from(front);
    println!("{}", front.local_addr()?);
    // libzmq does not tell where a message came from: the first datagram is read here.
    let (_, edge) = front.recv_from(&mut [0; 65_536])?;
    let context = Context::new();
    let back = free_port()?;
    let from_edge = context.dish(&format!("udp://{}", front.local_addr()?), GROUP)?;
    let from_cloud = context.dish(&format!("udp://127.0.0.1:{back}"), GROUP)?;
    let to_cloud = context.radio(&format!("udp://{cloud}"))?;
    let to_edge = context.radio(&format!("udp://{edge}"))?;
    std::thread::spawn(move || {
        let end = pass(&from_cloud, &to_edge, |_| {});
        eprintln!("the relay from cloud to edge ends: {end:?}");
        std::process::exit(1);
    });
    pass(&from_edge, &to_cloud, |body| {
        for (kind, at) in REPLY_PORTS {
            if body.first() == Some(&kind)
                && let Some(port) = body.get_mut(at..at + 2)
            {
                port.copy_from_slice(&back.to_be_bytes());
            }
        }
    })
}
