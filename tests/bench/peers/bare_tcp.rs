//! Lower bound of all transports: a ping-pong over one plain TCP connection, blocking.
//!
//! Both ends run on one machine and stamp with its wall clock, before sending and after the last byte is received.
//! Buffers are reused for every message.
//!
//! `bare-tcp serve ADDRESS`, and at the same time `bare-tcp drive ADDRESS UP-BYTES DOWN-BYTES SECONDS`, which prints
//! one JSON object.

mod round_trips;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};

use anyhow::{Context, bail};
use peernet_clock::{Clock, ClockIdentity, SystemClock, WallTime};
use serde_json::Value;

use self::round_trips::RoundTrips;

/// Length of the server's two stamps at the beginning of each answer, bytes.
const STAMPS_BYTES: usize = 16;

fn main() -> anyhow::Result<()> {
    let clock = SystemClock::new(ClockIdentity::from_system(ClockIdentity::SYSTEM)?);
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["serve", address] => serve(&clock, address),
        ["drive", address, up, down, seconds] => {
            let figures = drive(&clock, address, (up.parse()?, down.parse()?), seconds.parse()?)?;
            #[expect(clippy::print_stdout, reason = "the result that was asked for")]
            {
                println!("{figures}");
            }
            Ok(())
        }
        _ => bail!("usage: bare-tcp serve ADDRESS | bare-tcp drive ADDRESS UP-BYTES DOWN-BYTES SECONDS"),
    }
}

/// Answers one client.
fn serve(clock: &dyn Clock, address: &str) -> anyhow::Result<()> {
    let listener = TcpListener::bind(address).with_context(|| format!("cannot listen on {address}"))?;
    let (mut stream, _) = listener.accept()?;
    stream.set_nodelay(true)?;
    let mut request = vec![0; read_size(&mut stream)?];
    let mut answer = vec![0x5a; read_size(&mut stream)?];
    while stream.read_exact(&mut request).is_ok() {
        let received = clock.wall();
        answer[..8].copy_from_slice(&received.unix_nanos().to_le_bytes());
        answer[8..STAMPS_BYTES].copy_from_slice(&clock.wall().unix_nanos().to_le_bytes());
        stream.write_all(&answer)?;
    }
    Ok(())
}

fn drive(
    clock: &dyn Clock,
    address: &str,
    (up, down): (usize, usize),
    seconds: u64,
) -> anyhow::Result<Value> {
    if down < STAMPS_BYTES {
        bail!("an answer of {down} bytes has no room for its stamps; ask for {STAMPS_BYTES} or more");
    }
    let mut stream = TcpStream::connect(address).with_context(|| format!("cannot connect to {address}"))?;
    stream.set_nodelay(true)?;
    stream.write_all(&(up as u64).to_le_bytes())?;
    stream.write_all(&(down as u64).to_le_bytes())?;
    let request = vec![0xa5; up];
    let mut answer = vec![0; down];
    let mut round_trips = RoundTrips::new(seconds)?;
    while let Some(begin) = round_trips.next() {
        let sent = clock.wall();
        stream.write_all(&request)?;
        stream.read_exact(&mut answer)?;
        let received = clock.wall();
        let (upload, download) = (stamp_at(&answer, 0)? - sent, received - stamp_at(&answer, 8)?);
        round_trips.record(begin, Some(&[("upload", upload), ("download", download)]));
    }
    round_trips.figures()
}

fn read_size(stream: &mut TcpStream) -> anyhow::Result<usize> {
    let mut bytes = [0; 8];
    stream.read_exact(&mut bytes).context("no size came")?;
    Ok(usize::try_from(u64::from_le_bytes(bytes))?)
}

fn stamp_at(answer: &[u8], offset: usize) -> anyhow::Result<WallTime> {
    let bytes: [u8; 8] = answer[offset..offset + 8].try_into()?;
    Ok(WallTime::from_unix_nanos(i64::from_le_bytes(bytes)))
}
