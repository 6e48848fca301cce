//! `zmq-udp` through libzmq: a relay between an edge and a cloud of PEERNet that reads and writes with a real RADIO and
//! DISH in both directions. Fails unless every request is answered byte for byte or recorded as lost.

mod libzmq;

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use libzmq::{Context, Socket};
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_logger::{HostId, Recorder};
use peernet_networks::{
    Incoming, Listener, PeerClock, RequestError, SESSION_VERSIONS, Session, SessionAccepted,
    SessionHello, SessionSettings,
};
use peernet_sample::{Description, Sample};
use peernet_stream::Hardware;
use socket2::{Domain, Type};

/// The group of all datagrams.
const GROUP: &str = "peernet";

/// Where a hello and a request for a connection name the port of the edge's DISH.
const REPLY_PORTS: [(u8, usize); 2] = [(1, 10), (3, 25)];

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("interop", "system")))
}

/// A port that nobody has.
fn free_port() -> Result<u16> {
    Ok(UdpSocket::bind("127.0.0.1:0")?.local_addr()?.port())
}

/// Passes everything that a DISH receives on to a RADIO.
fn pass(from: Socket, to: Socket, change: impl Fn(&mut Vec<u8>) + Send + 'static) {
    std::thread::spawn(move || {
        loop {
            let passed = from.receive().and_then(|(group, mut body)| {
                ensure!(group == GROUP, "a message of the group {group}");
                change(&mut body);
                to.send(&group, &body)
            });
            if let Err(error) = passed {
                eprintln!("the relay ends: {error}");
                std::process::exit(1);
            }
        }
    });
}

/// Begins to relay between the edge that dials `front` and the cloud.
fn relay(front: &UdpSocket, cloud: SocketAddr) -> Result<()> {
    // libzmq does not tell where a message came from: the first datagram is read here.
    let (_, edge) = front.recv_from(&mut [0; 65_536])?;
    let context = Context::new();
    let back = free_port()?;
    let from_edge = context.dish(&format!("udp://{}", front.local_addr()?), GROUP)?;
    let from_cloud = context.dish(&format!("udp://127.0.0.1:{back}"), GROUP)?;
    let to_cloud = context.radio(&format!("udp://{cloud}"))?;
    let to_edge = context.radio(&format!("udp://{edge}"))?;
    pass(from_edge, to_cloud, move |body| {
        for (kind, at) in REPLY_PORTS {
            if body.first() == Some(&kind)
                && let Some(port) = body.get_mut(at..at + 2)
            {
                port.copy_from_slice(&back.to_be_bytes());
            }
        }
    });
    pass(from_cloud, to_edge, |_| {});
    Ok(())
}

async fn serve(mut listener: Listener, host: HostId) {
    while let Some(incoming) = listener.next().await {
        match incoming {
            Incoming::Open(open) => {
                let accepted = SessionAccepted {
                    host,
                    name: "cloud".parse().expect("a name"),
                    clock: ClockIdentity::new("interop", "system"),
                    version: "interop".into(),
                    model: "echo".parse().expect("a name"),
                    device: "cpu".into(),
                    facts: Vec::new(),
                    host_clock: PeerClock::default(),
                    probes: None,
                    instance: 1,
                    probe_key: None,
                    conditions: Vec::new(),
                    hardware: Hardware::default(),
                };
                assert!(open.accept(accepted), "the edge is there");
            }
            Incoming::Request(request) => request.reply.send(request.log, Ok(request.sample)),
            Incoming::Closed { .. } => {}
            Incoming::Remark { text, .. } | Incoming::Refused { text, .. } => eprintln!("{text}"),
        }
    }
}

#[tokio::main]
async fn main() -> Result<()> {
    for datagram_bytes in [1_200, 8_192] {
        run(datagram_bytes).await?;
    }
    Ok(())
}

async fn run(datagram_bytes: u64) -> Result<()> {
    // libzmq keeps the system's default buffers.
    let settings = SessionSettings { datagram_bytes, socket_buffer_bytes: 64 << 10, ..SessionSettings::default() };
    let (host, any) = (HostId::random(), "udp://127.0.0.1:0".parse()?);
    let listener = Listener::bind(&any, settings.clone(), host, clock()).await?;
    let cloud: SocketAddr = listener.address().authority().parse()?;
    tokio::spawn(serve(listener, host));

    // The DISH takes the port while this socket has it, so that nobody finds it closed.
    let front = socket2::Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    front.set_reuse_address(true)?;
    front.bind(&SocketAddr::from(([127, 0, 0, 1], 0)).into())?;
    let front = UdpSocket::from(front);
    let address = format!("udp://{}", front.local_addr()?).parse()?;
    let relaying = std::thread::spawn(move || relay(&front, cloud).map(|()| front));

    let hello = SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "edge".parse()?,
        clock: ClockIdentity::new("interop", "system"),
        pipeline: "interop".parse()?,
        model: None,
        device: None,
        clock_socket: None,
    };
    let session = Session::open(&address, hello, settings, clock()).await?;
    println!("datagrams of {datagram_bytes} bytes through libzmq's RADIO and DISH, both ways");
    println!("{:>12} {:>9} {:>9} {:>6}", "bytes", "requests", "answered", "lost");
    for (size, count) in [(0, 100), (1, 100), (1_000, 500), (60_000, 100), (1_200_000, 20), (20_000_000, 2)] {
        let (mut answered, mut lost) = (0, 0);
        for n in 0..count {
            let bytes: Vec<u8> = (0..size).map(|i| (i * 7 + n) as u8).collect();
            let sent = Sample::of(Description::bytes(), bytes.into());
            let log = Recorder::begin(clock(), HostId::random());
            match session.request(log, &sent, Duration::from_secs(60)).await.result {
                Ok(answer) => {
                    ensure!(answer == sent, "an answer of {size} bytes differs");
                    answered += 1;
                }
                Err(RequestError::Lost(_)) => lost += 1,
                Err(other) => return Err(other.into()),
            }
        }
        println!("{size:>12} {count:>9} {answered:>9} {lost:>6}");
        ensure!(answered > 0 || size > 1_000_000, "nothing of {size} bytes was answered");
    }
    session.close().await;
    relaying.join().ok().context("the relay panicked")??;
    Ok(())
}
