//! Relay between an edge and a cloud of `zmq-udp`, which uses RADIO and DISH of libzmq in both directions. Prints the port
//! to which the edge has to send, and runs until it is killed or an error occurs.
//!
//! Usage: `peernet-interop-zmq-udp CLOUD` (address and port on loopback)

mod libzmq;

use std::net::{SocketAddr, UdpSocket};

use anyhow::{Context as _, Result, ensure};
use libzmq::{Context, Socket};
use socket2::{Domain, Type};

/// Group of all datagrams.
const GROUP: &str = "peernet";

/// First byte of a hello and of a connection request, each with the offset of the port of the edge's DISH.
const REPLY_PORTS: [(u8, usize); 2] = [(1, 10), (3, 25)];

/// Returns a free port.
fn free_port() -> Result<u16> {
    Ok(UdpSocket::bind("127.0.0.1:0")?.local_addr()?.port())
}

/// Forwards everything that a DISH receives to a RADIO; returns the first error.
fn forward(from: &Socket, to: &Socket, change: impl Fn(&mut Vec<u8>)) -> Result<()> {
    loop {
        let (group, mut body) = from.receive()?;
        ensure!(group == GROUP, "a message of the group {group}");
        change(&mut body);
        to.send(&group, &body)?;
    }
}

fn main() -> Result<()> {
    let cloud: SocketAddr = std::env::args().nth(1).context("no address of a cloud")?.parse()?;
    // The DISH binds the same port while this socket still holds it, so that no other process can take
    // the port.
    let edge_side = socket2::Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    edge_side.set_reuse_address(true)?;
    edge_side.bind(&SocketAddr::from(([127, 0, 0, 1], 0)).into())?;
    let edge_side = UdpSocket::from(edge_side);
    println!("{}", edge_side.local_addr()?);
    // libzmq does not report the sender of a message, so the first datagram is read here. The edge sends this datagram,
    // a hello, again.
    let (_, edge) = edge_side.recv_from(&mut [0; 65_536])?;
    let context = Context::new();
    let cloud_side_port = free_port()?;
    let from_edge = context.dish(&format!("udp://{}", edge_side.local_addr()?), GROUP)?;
    let from_cloud = context.dish(&format!("udp://127.0.0.1:{cloud_side_port}"), GROUP)?;
    let to_cloud = context.radio(&format!("udp://{cloud}"))?;
    let to_edge = context.radio(&format!("udp://{edge}"))?;
    std::thread::spawn(move || {
        let end = forward(&from_cloud, &to_edge, |_| {});
        eprintln!("the relay from cloud to edge ends: {end:?}");
        std::process::exit(1);
    });
    // The cloud must answer to the DISH `from_cloud`. Without the change, it answers to another port.
    forward(&from_edge, &to_cloud, |body| {
        for (kind, offset) in REPLY_PORTS {
            if body.first() == Some(&kind)
                && let Some(port) = body.get_mut(offset..offset + 2)
            {
                port.copy_from_slice(&cloud_side_port.to_be_bytes());
            }
        }
    })
}
