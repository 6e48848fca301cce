//! Closed-loop round trips over loopback: rounds of a session alternate with rounds of bare TCP.
//!
//! `cargo bench -p peernet-networks --bench round_trip -- [--processes] [--runtime current|multi] [--answer BYTES|same]
//! [--sizes BYTES,…] [--rounds N]`. The rounds alternate, so that a disturbance of the machine affects the session and
//! TCP alike. `--processes` runs the cloud in a separate process instead of a thread. The edge sends the payload, the
//! cloud answers with 64 bytes or as `--answer` says. `upload` is the one-way time from just before the message is
//! handed over until the whole message has arrived; edge and cloud read one clock.

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_logger::{HostId, Measure, Recorder, Slug};
use peernet_networks::{
    Address, Incoming, Listener, PeerClock, SESSION_VERSIONS, Session, SessionAccepted, SessionHello,
    SessionSettings,
};
use peernet_sample::{Description, Sample};
use peernet_stream::Hardware;

type BenchResult<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// The arguments of the benchmark.
#[derive(Clone, Debug)]
struct Arguments {
    sizes: Vec<usize>,
    /// Length of an answer; `None` for the length of the payload. Bytes.
    answer: Option<usize>,
    rounds: usize,
    has_multi_thread_runtimes: bool,
    /// Whether the cloud runs in a separate process.
    has_two_processes: bool,
    /// Whether this process is the cloud's process.
    is_cloud: bool,
}

fn main() -> BenchResult<()> {
    let arguments = Arguments::parse()?;
    if arguments.is_cloud {
        let (bare_address, session_address) = start_cloud(&arguments)?;
        println!("{bare_address} {session_address}");
        // The edge ends this process by closing its standard input.
        std::io::stdin().read_to_end(&mut Vec::new())?;
        return Ok(());
    }
    let mut child = None;
    let (bare_address, session_address) = if arguments.has_two_processes {
        let cloud_arguments = std::env::args().skip(1).chain(["--cloud".to_owned()]);
        let process = Command::new(std::env::current_exe()?)
            .args(cloud_arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let process = child.insert(process);
        let mut line = String::new();
        BufReader::new(process.stdout.take().ok_or("no stdout")?).read_line(&mut line)?;
        let (bare_address, session_address) = line.trim().split_once(' ').ok_or("the cloud did not start")?;
        (bare_address.to_owned(), session_address.parse::<Address>()?)
    } else {
        start_cloud(&arguments)?
    };
    run_edge(&arguments, &bare_address, &session_address)?;
    if let Some(mut process) = child {
        drop(process.stdin.take());
        process.wait()?;
    }
    Ok(())
}

impl Arguments {
    fn parse() -> BenchResult<Self> {
        let mut parsed = Self {
            sizes: vec![64, 1_000, 150_000, 1_200_000],
            answer: Some(64),
            rounds: 20,
            has_multi_thread_runtimes: false,
            has_two_processes: false,
            is_cloud: false,
        };
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
            match argument.as_str() {
                "--processes" => parsed.has_two_processes = true,
                "--cloud" => parsed.is_cloud = true,
                "--runtime" => parsed.has_multi_thread_runtimes = value()? == "multi",
                "--rounds" => parsed.rounds = value()?.parse()?,
                "--sizes" => {
                    parsed.sizes = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?;
                }
                "--answer" => {
                    let answer = value()?;
                    parsed.answer = if answer == "same" { None } else { Some(answer.parse()?) };
                }
                // Cargo passes this argument to every benchmark.
                "--bench" => {}
                other => return Err(format!("unknown argument {other}").into()),
            }
        }
        Ok(parsed)
    }

    fn runtime(&self) -> BenchResult<tokio::runtime::Runtime> {
        let mut builder = if self.has_multi_thread_runtimes {
            tokio::runtime::Builder::new_multi_thread()
        } else {
            tokio::runtime::Builder::new_current_thread()
        };
        Ok(builder.enable_all().build()?)
    }

    fn answer_bytes(&self, size: usize) -> usize {
        self.answer.unwrap_or(size)
    }
}

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("bench", "system")))
}

/// Starts the servers of both contenders. Returns their addresses.
fn start_cloud(arguments: &Arguments) -> BenchResult<(String, Address)> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let bare_address = listener.local_addr()?.to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            // `serve_bare` always ends with an error, at the latest when the edge closes the connection.
            let _ = stream.map_err(Into::into).and_then(serve_bare);
        }
    });
    let (address_sender, address_receiver) = std::sync::mpsc::sync_channel(1);
    let arguments = arguments.clone();
    std::thread::spawn(move || -> BenchResult<()> {
        let runtime = arguments.runtime()?;
        // The server runs in a task, as in an agent, so that it runs on a worker thread: the main future of a
        // multi-thread runtime does not.
        runtime.block_on(async { tokio::spawn(serve_session(arguments, address_sender)).await })?
    });
    Ok((bare_address, address_receiver.recv()?))
}

/// Answers each message `payload length u64 | answer length u64 | payload` with `arrival stamp i64 | answer`.
fn serve_bare(mut stream: TcpStream) -> BenchResult<()> {
    let clock = clock();
    stream.set_nodelay(true)?;
    let mut payload = Vec::new();
    let mut header = [0; 16];
    loop {
        stream.read_exact(&mut header)?;
        let (payload_bytes, answer_bytes) =
            (read_u64(&header[..8]) as usize, read_u64(&header[8..]) as usize);
        payload.resize(payload_bytes, 0);
        stream.read_exact(&mut payload)?;
        let arrival_nanos = clock.wall().unix_nanos();
        // The answer is the beginning of the payload. A longer answer is filled with zeros.
        payload.resize(payload_bytes.max(answer_bytes), 0);
        let mut reply = arrival_nanos.to_le_bytes().to_vec();
        reply.extend_from_slice(&payload[..answer_bytes]);
        stream.write_all(&reply)?;
    }
}

fn read_u64(bytes: &[u8]) -> u64 {
    bytes.try_into().map_or(0, u64::from_le_bytes)
}

async fn serve_session(
    arguments: Arguments,
    address_sender: std::sync::mpsc::SyncSender<Address>,
) -> BenchResult<()> {
    let (host, clock) = (HostId::random(), clock());
    let any_port = "tcp://127.0.0.1:0".parse()?;
    let mut listener = Listener::bind(&any_port, SessionSettings::default(), host, clock.clone()).await?;
    address_sender.send(listener.address().clone())?;
    while let Some(incoming) = listener.next().await {
        match incoming {
            Incoming::Open(open) => {
                let accepted = SessionAccepted {
                    host,
                    name: "cloud".parse()?,
                    clock: clock.identity().clone(),
                    version: String::new(),
                    model: open.hello.model.clone().ok_or("a hello without a model")?,
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
                let payload = &request.sample.parts[0].bytes;
                // The answer is the beginning of the payload, and therefore not longer than the payload.
                let answer = payload.slice(..arguments.answer_bytes(payload.len()).min(payload.len()));
                request.reply.send(request.recorder, Ok(Sample::from_part(Description::bytes(), answer)));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Times of one contender with one payload size.
#[derive(Default)]
struct ContenderTimes {
    trips: Vec<Span>,
    uploads: Vec<Span>,
}

impl ContenderTimes {
    fn add(&mut self, trip: Span, upload: Span) {
        self.trips.push(trip);
        self.uploads.push(upload);
    }
}

fn run_edge(arguments: &Arguments, bare_address: &str, address: &Address) -> BenchResult<()> {
    let runtime = arguments.runtime()?;
    let mut stream = TcpStream::connect(bare_address)?;
    stream.set_nodelay(true)?;
    let hello = SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "edge".parse()?,
        clock: clock().identity().clone(),
        pipeline: "bench".parse()?,
        model: Some("echo".parse::<Slug>()?),
        device: None,
        clock_socket: None,
    };
    let opening = Session::open(address, hello, SessionSettings::default(), clock());
    let session = runtime.block_on(opening)?;
    println!(
        "{} runtimes, {}, answers of {}\n",
        if arguments.has_multi_thread_runtimes { "multi-thread" } else { "current-thread" },
        if arguments.has_two_processes { "two processes" } else { "two threads" },
        arguments.answer.map_or("the same size".into(), |bytes| format!("{bytes} bytes")),
    );
    println!(
        "{:>9} | {:>8} {:>8} {:>8} {:>8} | {:>7} {:>7} {:>6} | {:>7} {:>7} {:>6}",
        "bytes",
        "TCP p50",
        "TCP p99",
        "sess p50",
        "sess p99",
        "TCP/s",
        "sess/s",
        "ratio",
        "TCP up",
        "sess up",
        "ratio"
    );
    for &size in &arguments.sizes {
        let payload = Bytes::from((0..size).map(|i| (i * 31) as u8).collect::<Vec<u8>>());
        // Larger payloads get fewer round trips, so that a round takes a similar time for every size.
        let trips = (20_000_000 / (size + 20_000)).clamp(30, 500);
        let (mut tcp_times, mut session_times) = (ContenderTimes::default(), ContenderTimes::default());
        for round in 0..=arguments.rounds {
            let mut bare_round = ContenderTimes::default();
            run_bare_round(&mut stream, &payload, arguments.answer_bytes(size), trips, &mut bare_round)?;
            let task = run_session_round(session.clone(), payload.clone(), trips);
            let mut session_round = runtime.block_on(async { tokio::spawn(task).await })??;
            // The first round only warms up both contenders.
            if round > 0 {
                tcp_times.trips.append(&mut bare_round.trips);
                tcp_times.uploads.append(&mut bare_round.uploads);
                session_times.trips.append(&mut session_round.trips);
                session_times.uploads.append(&mut session_round.uploads);
            }
        }
        print_row(size, &mut tcp_times, &mut session_times);
    }
    println!(
        "\nsess: session, up: p50 of upload, ratio: session to TCP; times in µs; {:?}",
        session.statistics()
    );
    runtime.block_on(session.close());
    Ok(())
}

fn run_bare_round(
    stream: &mut TcpStream,
    payload: &[u8],
    answer_bytes: usize,
    trips: usize,
    times: &mut ContenderTimes,
) -> BenchResult<()> {
    let clock = clock();
    let mut message = (payload.len() as u64).to_le_bytes().to_vec();
    message.extend_from_slice(&(answer_bytes as u64).to_le_bytes());
    message.extend_from_slice(payload);
    let mut reply = vec![0; 8 + answer_bytes];
    for _ in 0..trips {
        let start = clock.stamp();
        stream.write_all(&message)?;
        stream.read_exact(&mut reply)?;
        let arrival_nanos = read_u64(&reply[..8]) as i64;
        let upload = Span::from_nanos(arrival_nanos - start.wall.unix_nanos());
        times.add(clock.mono() - start.mono, upload);
    }
    Ok(())
}

async fn run_session_round(session: Session, payload: Bytes, trips: usize) -> BenchResult<ContenderTimes> {
    let (clock, host, mut times) = (clock(), HostId::random(), ContenderTimes::default());
    for _ in 0..trips {
        let sample = Sample::from_part(Description::bytes(), payload.clone());
        let start = clock.mono();
        let recorder = Recorder::new(clock.clone(), host);
        let completed = session.request(recorder, &sample, Duration::from_secs(10)).await;
        let trip = clock.mono() - start;
        completed.result?;
        let upload = completed
            .upload
            .and_then(|upload_id| completed.recorder.tree().get(upload_id))
            .map(|node| &node.measure);
        let Some(Measure::Transit(upload)) = upload else { return Err("no upload".into()) };
        let upload = upload.received.ok_or("upload did not end")? - upload.sent;
        times.add(trip, upload);
    }
    Ok(times)
}

fn print_row(size: usize, tcp_times: &mut ContenderTimes, session_times: &mut ContenderTimes) {
    let quantile_micros = |spans: &mut Vec<Span>, quantile: f64| {
        spans.sort_unstable();
        spans[((spans.len() - 1) as f64 * quantile) as usize].seconds() * 1e6
    };
    let rate = |spans: &[Span]| spans.len() as f64 / spans.iter().copied().sum::<Span>().seconds();
    let (tcp_rate, session_rate) = (rate(&tcp_times.trips), rate(&session_times.trips));
    let (tcp_upload, session_upload) =
        (quantile_micros(&mut tcp_times.uploads, 0.5), quantile_micros(&mut session_times.uploads, 0.5));
    println!(
        "{size:>9} | {:>8.1} {:>8.1} {:>8.1} {:>8.1} | {tcp_rate:>7.0} {session_rate:>7.0} {:>6.2} | {tcp_upload:>7.1} {session_upload:>7.1} {:>6.2}",
        quantile_micros(&mut tcp_times.trips, 0.5),
        quantile_micros(&mut tcp_times.trips, 0.99),
        quantile_micros(&mut session_times.trips, 0.5),
        quantile_micros(&mut session_times.trips, 0.99),
        session_rate / tcp_rate,
        session_upload / tcp_upload,
    );
}
