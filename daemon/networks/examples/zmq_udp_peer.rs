//! An edge and a cloud of `zmq-udp` with a relay between them that uses libzmq (`tests/interop/zmq-udp`). Fails unless
//! every request is answered with its own bytes or recorded as lost. Also fails if no request of a length up to 1 MB is
//! answered.
//!
//! Usage: `zmq_udp_peer RELAY`. The relay is a program that gets the cloud's address as its argument and prints its
//! own address.
#![expect(clippy::print_stdout, reason = "a test program prints its results")]

use std::error::Error;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_logger::{HostId, Recorder};
use peernet_networks::{
    Incoming, Listener, PeerClock, RequestError, SESSION_VERSIONS, Session, SessionAccepted, SessionHello,
    SessionSettings,
};
use peernet_sample::{Description, Sample};
use peernet_stream::Hardware;

/// Time limit of an answer.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Length of a request in bytes, and number of requests of this length.
const REQUESTS: [(usize, usize); 6] =
    [(0, 100), (1, 100), (1_000, 500), (60_000, 100), (1_200_000, 20), (20_000_000, 2)];

/// The process of the relay, which is killed when the test ends.
struct Relay(Child);

impl Relay {
    /// Starts the relay to a cloud. Returns it with the address that the edge connects to.
    fn start(program: &str, cloud: &str) -> Result<(Self, String), Box<dyn Error>> {
        let mut relay = Self(Command::new(program).arg(cloud).stdout(Stdio::piped()).spawn()?);
        let mut address = String::new();
        BufReader::new(relay.0.stdout.take().ok_or("no output")?).read_line(&mut address)?;
        Ok((relay, address.trim().to_owned()))
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        // Killing fails if the relay has already exited.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn identity() -> ClockIdentity {
    ClockIdentity::new("interop", "system")
}

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(identity()))
}

/// Accepts every session and answers each request with the request's own payload.
async fn serve(mut listener: Listener, accepted: SessionAccepted) {
    while let Some(incoming) = listener.next().await {
        match incoming {
            Incoming::Open(open) => assert!(open.accept(accepted.clone()), "the edge is there"),
            Incoming::Request(request) => request.reply.send(request.recorder, Ok(request.sample)),
            Incoming::Closed { .. } => {}
            Incoming::Remark { text, .. } | Incoming::Refused { text, .. } => println!("{text}"),
        }
    }
}

/// Sends requests of one size. Returns the numbers of answered and of lost requests.
async fn exchange(session: &Session, size: usize, count: usize) -> Result<(usize, usize), Box<dyn Error>> {
    let (mut answered, mut lost) = (0, 0);
    for number in 0..count {
        let bytes: Vec<u8> = (0..size).map(|index| ((index * 7 + number) % 256) as u8).collect();
        let request = Sample::from_part(Description::bytes(), bytes.into());
        let recorder = Recorder::new(clock(), HostId::random());
        match session.request(recorder, &request, TIMEOUT).await.result {
            Ok(answer) if answer == request => answered += 1,
            Ok(_) => return Err(format!("an answer to {size} bytes differs from its request").into()),
            Err(RequestError::Lost(_)) => lost += 1,
            Err(error) => return Err(error.into()),
        }
    }
    Ok((answered, lost))
}

async fn run(relay: &str, datagram_bytes: u64) -> Result<(), Box<dyn Error>> {
    // The relay's sockets have buffers of the system's default size, because libzmq does not change the size. The
    // number of bytes in flight follows the buffers of edge and cloud, so these buffers are small, too.
    let settings =
        SessionSettings { datagram_bytes, socket_buffer_bytes: 64 << 10, ..SessionSettings::default() };
    let host = HostId::random();
    let listener = Listener::bind(&"udp://127.0.0.1:0".parse()?, settings.clone(), host, clock()).await?;
    let (mut relay, address) = Relay::start(relay, &listener.address().authority())?;
    let accepted = SessionAccepted {
        host,
        name: "cloud".parse()?,
        clock: identity(),
        version: "interop".into(),
        model: "echo".parse()?,
        device: "cpu".into(),
        facts: Vec::new(),
        host_clock: PeerClock::default(),
        probes: None,
        instance: 1,
        probe_key: None,
        conditions: Vec::new(),
        hardware: Hardware::default(),
    };
    tokio::spawn(serve(listener, accepted));

    let hello = SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "edge".parse()?,
        clock: identity(),
        pipeline: "interop".parse()?,
        model: None,
        device: None,
        clock_socket: None,
    };
    let session = Session::open(&format!("udp://{address}").parse()?, hello, settings, clock()).await?;
    println!("datagrams of {datagram_bytes} bytes through libzmq's RADIO and DISH, both ways");
    println!("{:>12} {:>9} {:>9} {:>6}", "bytes", "requests", "answered", "lost");
    for (size, count) in REQUESTS {
        let (answered, lost) = exchange(&session, size, count).await?;
        println!("{size:>12} {count:>9} {answered:>9} {lost:>6}");
        // The relay may lose a part of every message above 1 MB.
        if answered == 0 && size <= 1_000_000 {
            return Err(format!("no request of {size} bytes was answered").into());
        }
    }
    session.close().await;
    match relay.0.try_wait()? {
        None => Ok(()),
        Some(status) => Err(format!("the relay ended: {status}").into()),
    }
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let relay = std::env::args().nth(1).ok_or("usage: zmq_udp_peer RELAY")?;
    for datagram_bytes in [1_200, 8_192] {
        run(&relay, datagram_bytes).await?;
    }
    Ok(())
}
