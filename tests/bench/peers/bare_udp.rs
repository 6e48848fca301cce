//! Lower bound of datagram transports: a ping-pong over plain UDP with datagrams of a fixed length, blocking, with
//! one system call per datagram and without reassembly. A message with a lost datagram is given up.
//!
//! `bare-udp serve ADDRESS DATAGRAM-BYTES`, and at the same time
//! `bare-udp drive ADDRESS DATAGRAM-BYTES UP-BYTES DOWN-BYTES SECONDS`, which prints one JSON object.

mod round_trips;

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use anyhow::{Context, bail};
use serde_json::Value;
use socket2::SockRef;

use self::round_trips::RoundTrips;

/// Socket buffers, bytes: all datagrams of a message fit.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Longest wait for the next datagram of an answer.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(200);

/// Length of the head of each datagram: number of the message, length of the message and of its answer, 32 bits each.
const HEAD_BYTES: usize = 12;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["serve", address, datagram_bytes] => serve(address, datagram_bytes.parse()?),
        ["drive", address, datagram_bytes, up, down, seconds] => {
            let figures =
                drive(address, datagram_bytes.parse()?, (up.parse()?, down.parse()?), seconds.parse()?)?;
            #[expect(clippy::print_stdout, reason = "the result that was asked for")]
            {
                println!("{figures}");
            }
            Ok(())
        }
        _ => bail!(
            "usage: bare-udp serve ADDRESS DATAGRAM-BYTES | bare-udp drive ADDRESS DATAGRAM-BYTES UP-BYTES \
             DOWN-BYTES SECONDS"
        ),
    }
}

/// Socket and the length of its datagrams.
struct Endpoint {
    socket: UdpSocket,
    datagram_bytes: usize,
    buffer: Vec<u8>,
}

/// Head of a datagram.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Head {
    number: u32,
    bytes: u32,
    answer_bytes: u32,
}

impl Endpoint {
    fn bind(address: &str, datagram_bytes: usize) -> anyhow::Result<Self> {
        if datagram_bytes <= HEAD_BYTES {
            bail!("datagrams of {datagram_bytes} bytes have no room for a head of {HEAD_BYTES}");
        }
        let socket = UdpSocket::bind(address).with_context(|| format!("cannot bind {address}"))?;
        SockRef::from(&socket).set_recv_buffer_size(SOCKET_BUFFER_BYTES)?;
        SockRef::from(&socket).set_send_buffer_size(SOCKET_BUFFER_BYTES)?;
        Ok(Self { socket, datagram_bytes, buffer: vec![0x5a; datagram_bytes] })
    }

    /// Returns the number of datagrams of a message of this length.
    fn datagram_count(&self, bytes: u32) -> usize {
        (bytes as usize).div_ceil(self.datagram_bytes - HEAD_BYTES).max(1)
    }

    fn send(&mut self, head: Head, to: SocketAddr) -> anyhow::Result<()> {
        for (field, bytes) in
            [head.number, head.bytes, head.answer_bytes].into_iter().zip(self.buffer.chunks_mut(4))
        {
            bytes.copy_from_slice(&field.to_le_bytes());
        }
        let mut remaining = head.bytes as usize;
        for _ in 0..self.datagram_count(head.bytes) {
            let length = remaining.min(self.datagram_bytes - HEAD_BYTES);
            remaining -= length;
            self.socket.send_to(&self.buffer[..HEAD_BYTES + length], to)?;
        }
        Ok(())
    }

    /// Receives the next datagram; returns `None` if none arrives in time.
    fn receive(&mut self) -> anyhow::Result<Option<(Head, SocketAddr)>> {
        let (length, from) = match self.socket.recv_from(&mut self.buffer) {
            Ok(received) => received,
            Err(error) if matches!(error.kind(), std::io::ErrorKind::WouldBlock) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let field = |offset: usize| {
            self.buffer[..length]
                .get(offset..offset + 4)?
                .first_chunk()
                .map(|field| u32::from_le_bytes(*field))
        };
        let (Some(number), Some(bytes), Some(answer_bytes)) = (field(0), field(4), field(8)) else {
            bail!("a datagram of {length} bytes came from {from}");
        };
        Ok(Some((Head { number, bytes, answer_bytes }, from)))
    }
}

/// Answers every message whose datagrams have all arrived.
fn serve(address: &str, datagram_bytes: usize) -> anyhow::Result<()> {
    let mut endpoint = Endpoint::bind(address, datagram_bytes)?;
    let (mut current, mut received) = (None, 0);
    loop {
        let Some((head, from)) = endpoint.receive()? else { continue };
        if current != Some(head) {
            (current, received) = (Some(head), 0);
        }
        received += 1;
        if received == endpoint.datagram_count(head.bytes) {
            endpoint.send(Head { bytes: head.answer_bytes, ..head }, from)?;
        }
    }
}

fn drive(
    address: &str,
    datagram_bytes: usize,
    (up, down): (u32, u32),
    seconds: u64,
) -> anyhow::Result<Value> {
    let to: SocketAddr = address.parse().with_context(|| format!("{address} is no address"))?;
    let mut endpoint = Endpoint::bind("0.0.0.0:0", datagram_bytes)?;
    endpoint.socket.set_read_timeout(Some(RECEIVE_TIMEOUT))?;
    let mut round_trips = RoundTrips::new(seconds)?;
    let mut number = 0;
    while let Some(begin) = round_trips.next() {
        number += 1;
        endpoint.send(Head { number, bytes: up, answer_bytes: down }, to)?;
        let mut remaining = endpoint.datagram_count(down);
        while remaining > 0 {
            match endpoint.receive()? {
                Some((head, _)) => remaining -= usize::from(head.number == number),
                None => break,
            }
        }
        round_trips.record(begin, (remaining == 0).then_some(&[]));
    }
    round_trips.figures()
}
