//! Closed-loop round trips over loopback: rounds of a session over `zmq-udp` alternate with rounds of bare UDP with
//! datagrams of the same length.
//!
//! `cargo bench -p peernet-networks --bench datagrams -- [--sizes BYTES,…] [--rounds N] [--datagram BYTES]`. The edge
//! sends the payload, the cloud answers with 64 bytes. Bare UDP uses one system call for each datagram and does not
//! reassemble messages.

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::error::Error;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_logger::{HostId, Recorder};
use peernet_networks::{
    Address, Incoming, Listener, PeerClock, SESSION_VERSIONS, Session, SessionAccepted, SessionHello,
    SessionSettings,
};
use peernet_sample::{Description, Sample};
use peernet_stream::Hardware;
use socket2::SockRef;

type BenchResult<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Length of an answer. Bytes.
const ANSWER_BYTES: usize = 64;

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("bench", "system")))
}

fn main() -> BenchResult<()> {
    let (mut sizes, mut rounds, mut datagram_bytes) = (vec![1_000, 150_000, 1_200_000], 20, 1_200_usize);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--sizes" => sizes = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?,
            "--rounds" => rounds = value()?.parse()?,
            "--datagram" => datagram_bytes = value()?.parse()?,
            // Cargo passes this argument to every benchmark.
            "--bench" => {}
            other => return Err(format!("unknown argument {other}").into()),
        }
    }
    let settings = SessionSettings { datagram_bytes: datagram_bytes as u64, ..SessionSettings::default() };
    let bare = BareUdp::start(datagram_bytes)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let address = runtime.block_on(serve(settings.clone()))?;
    let session = runtime.block_on(async { tokio::spawn(open(address, settings)).await })??;
    println!("datagrams of {datagram_bytes} bytes, answers of {ANSWER_BYTES} bytes, two threads");
    println!(
        "{:>9} | {:>9} {:>9} | {:>11} {:>11} | {:>8} {:>9} {:>6}",
        "bytes", "UDP p50", "UDP p99", "session p50", "session p99", "UDP/s", "session/s", "ratio"
    );
    for size in sizes {
        let payload = Bytes::from(vec![7; size]);
        // Larger payloads get fewer round trips, so that a round takes a similar time for every size.
        let trips = (20_000_000 / (size + 20_000)).clamp(20, 500);
        let (mut bare_times, mut session_times) = (Vec::new(), Vec::new());
        for round in 0..=rounds {
            let bare_round = bare.run_round(size, trips)?;
            let task = run_session_round(session.clone(), payload.clone(), trips);
            let session_round = runtime.block_on(async { tokio::spawn(task).await })??;
            // The first round only warms up both contenders.
            if round > 0 {
                bare_times.extend(bare_round);
                session_times.extend(session_round);
            }
        }
        print_row(size, &mut bare_times, &mut session_times);
    }
    println!("\ntimes in µs; {:?}", session.statistics());
    runtime.block_on(session.close());
    Ok(())
}

fn print_row(size: usize, bare_times: &mut [Span], session_times: &mut [Span]) {
    let quantile_micros = |spans: &mut [Span], quantile: f64| {
        spans.sort_unstable();
        spans[((spans.len() - 1) as f64 * quantile) as usize].seconds() * 1e6
    };
    let rate = |spans: &[Span]| spans.len() as f64 / spans.iter().copied().sum::<Span>().seconds();
    let (bare_rate, session_rate) = (rate(bare_times), rate(session_times));
    println!(
        "{size:>9} | {:>9.1} {:>9.1} | {:>11.1} {:>11.1} | {bare_rate:>8.0} {session_rate:>9.0} {:>6.2}",
        quantile_micros(bare_times, 0.5),
        quantile_micros(bare_times, 0.99),
        quantile_micros(session_times, 0.5),
        quantile_micros(session_times, 0.99),
        session_rate / bare_rate,
    );
}

/// Round trips over bare UDP: the first four bytes of each datagram are the number of datagrams of its message.
struct BareUdp {
    socket: UdpSocket,
    datagram_bytes: usize,
}

impl BareUdp {
    fn start(datagram_bytes: usize) -> BenchResult<Self> {
        let server = Self::socket()?;
        let address: SocketAddr = server.local_addr()?;
        std::thread::spawn(move || -> BenchResult<()> {
            let mut buffer = vec![0; 65_536];
            let mut received = 0;
            loop {
                let (length, from) = server.recv_from(&mut buffer)?;
                let datagram_count =
                    buffer[..length].first_chunk().map_or(1, |first| u32::from_le_bytes(*first));
                received += 1;
                if received >= datagram_count {
                    received = 0;
                    server.send_to(&[7; ANSWER_BYTES], from)?;
                }
            }
        });
        let socket = Self::socket()?;
        socket.connect(address)?;
        socket.set_read_timeout(Some(Duration::from_secs(5)))?;
        Ok(Self { socket, datagram_bytes })
    }

    fn socket() -> BenchResult<UdpSocket> {
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        SockRef::from(&socket).set_recv_buffer_size(4 << 20)?;
        SockRef::from(&socket).set_send_buffer_size(4 << 20)?;
        Ok(socket)
    }

    fn run_round(&self, size: usize, trips: usize) -> BenchResult<Vec<Span>> {
        let clock = clock();
        let mut buffer = vec![7; self.datagram_bytes];
        let datagram_count = size.div_ceil(self.datagram_bytes).max(1);
        buffer[..4].copy_from_slice(&(datagram_count as u32).to_le_bytes());
        let mut answer = [0; ANSWER_BYTES];
        (0..trips)
            .map(|_| {
                let started_at = clock.mono();
                for index in 0..datagram_count {
                    let length = (size - index * self.datagram_bytes).clamp(4, self.datagram_bytes);
                    self.socket.send(&buffer[..length])?;
                }
                self.socket.recv(&mut answer)?;
                Ok(clock.mono() - started_at)
            })
            .collect()
    }
}

async fn serve(settings: SessionSettings) -> BenchResult<Address> {
    let (host, any_port) = (HostId::random(), "udp://127.0.0.1:0".parse()?);
    let mut listener = Listener::bind(&any_port, settings, host, clock()).await?;
    let address = listener.address().clone();
    tokio::spawn(async move {
        while let Some(incoming) = listener.next().await {
            match incoming {
                Incoming::Open(open) => {
                    // The names do not matter to the benchmark, so the names of the hello serve.
                    let accepted = SessionAccepted {
                        host,
                        name: open.hello.name.clone(),
                        clock: open.hello.clock.clone(),
                        version: String::new(),
                        model: open.hello.pipeline.clone(),
                        device: "cpu".into(),
                        facts: Vec::new(),
                        host_clock: PeerClock::default(),
                        probes: None,
                        instance: 1,
                        probe_key: None,
                        conditions: Vec::new(),
                        hardware: Hardware::default(),
                    };
                    open.accept(accepted);
                }
                Incoming::Request(request) => {
                    let answer = Bytes::from_static(&[7; ANSWER_BYTES]);
                    request.reply.send(request.recorder, Ok(Sample::from_part(Description::bytes(), answer)));
                }
                _ => {}
            }
        }
    });
    Ok(address)
}

async fn open(address: Address, settings: SessionSettings) -> BenchResult<Session> {
    let hello = SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "edge".parse()?,
        clock: clock().identity().clone(),
        pipeline: "bench".parse()?,
        model: None,
        device: None,
        clock_socket: None,
    };
    Ok(Session::open(&address, hello, settings, clock()).await?)
}

async fn run_session_round(session: Session, payload: Bytes, trips: usize) -> BenchResult<Vec<Span>> {
    let (clock, host) = (clock(), HostId::random());
    let mut spans = Vec::new();
    for _ in 0..trips {
        let sample = Sample::from_part(Description::bytes(), payload.clone());
        let started_at = clock.mono();
        let recorder = Recorder::new(clock.clone(), host);
        let completed = session.request(recorder, &sample, Duration::from_secs(10)).await;
        // A lost request has no round trip; the statistics at the end count it.
        if completed.result.is_ok() {
            spans.push(clock.mono() - started_at);
        }
    }
    Ok(spans)
}
