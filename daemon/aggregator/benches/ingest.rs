//! Nodes per second that reach the disk: agents over real ZeroMQ into the aggregator, beside a bare loop that inserts
//! the same rows into the same schema. Both sync each transaction (`synchronous=FULL`).
//!
//! `cargo bench -p peernet-aggregator -- [NODES] [AGENTS] [ROUNDS]`

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

#[path = "../tests/it/generate.rs"]
#[expect(unreachable_pub, reason = "shared with the tests")]
mod generate;

use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_logger::stream::codec::{decode, encode};
use peernet_logger::stream::{Batch, Event, Hello, PROTOCOL, StreamId, ToAgent, ToAggregator};
use peernet_logger::{HostId, RunId};
use sqlx::sqlite::{SqliteArguments, SqliteConnectOptions, SqliteJournalMode, SqliteRow, SqliteSynchronous};
use sqlx::{Arguments, AssertSqlSafe, ConnectOptions, Connection, Row, SqliteConnection, TypeInfo, ValueRef};
use tokio_util::sync::CancellationToken;
use zeromq::{Message, Options, Socket, SocketType};

/// Iterations of 21 nodes in one batch: about 8,000 nodes, as agents cut them.
const ITERATIONS: u64 = 390;
const NODES: u64 = 21;
/// Batches under way per agent, as agents keep them.
const WINDOW: usize = 8;
/// Nodes per transaction, and rows per statement of the bare loop.
const COMMIT_NODES: usize = 30_000;
const ROWS: usize = 1_000;

/// An agent's messages, encoded before the clock runs.
struct Load {
    hello: Vec<u8>,
    stream: StreamId,
    frames: Vec<Bytes>,
}

#[tokio::main]
async fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let number = |at: usize, usual: u64| numbers.get(at).copied().unwrap_or(usual).max(1);
    let (nodes, agents, rounds) = (number(0, 2_000_000), number(1, 10), number(2, 3));
    let batches = nodes.div_ceil(agents * ITERATIONS * NODES);
    let nodes = batches * agents * ITERATIONS * NODES;
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "system")));
    println!("{nodes} nodes in {} batches from {agents} agents, {rounds} rounds", batches * agents);
    println!(
        "{:>5}  {:>22}  {:>22}  {:>5}  {:>10}  {:>7}",
        "round", "aggregator nodes/s", "bare loop nodes/s", "ratio", "bytes/node", "dropped"
    );
    for round in 1..=rounds {
        let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
        let (ours, bare) = (folder.path().join("aggregator.sqlite"), folder.path().join("bare.sqlite"));
        let loads: Vec<Load> = (0..agents).map(|agent| load(agent, batches)).collect();
        let seconds = ingest(&ours, loads, &clock).await;
        let stored: i64 = one(&ours, "SELECT count(*) FROM node").await;
        let bytes: i64 =
            one(&ours, "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size").await;
        let bare_seconds = bare_loop(&ours, &bare, &clock).await;
        let (rate, bare_rate) = (stored as f64 / seconds, stored as f64 / bare_seconds);
        println!(
            "{round:>5}  {rate:>22.0}  {bare_rate:>22.0}  {:>5.2}  {:>10.1}  {:>7}",
            rate / bare_rate,
            bytes as f64 / stored as f64,
            nodes as i64 - stored
        );
    }
}

/// A run of so many batches.
fn load(agent: u64, batches: u64) -> Load {
    let (host, stream, run) = (HostId::random(), StreamId::random(), RunId::random());
    let cloud = HostId::random();
    let description = generate::host(host, &format!("agent-{agent}"));
    let hello = Hello { protocol: PROTOCOL, host: description, stream, oldest: 1, process: 1 };
    let mut random = generate::Numbers(agent);
    let frames = (1..=batches).map(|number| {
        let first = (number == 1).then(|| generate::run_started(run, "line", generate::at(0.0)));
        let numbers = (number - 1) * ITERATIONS + 1..=number * ITERATIONS;
        let iterations =
            numbers.map(|n| Event::Iteration(generate::iteration(run, n, (host, cloud), &mut random)));
        let events = first.into_iter().chain(iterations).collect();
        Bytes::from(encode(&ToAggregator::Batch(Batch { host, stream, number, events })))
    });
    Load { hello: encode(&ToAggregator::Hello(hello)), stream, frames: frames.collect() }
}

/// Seconds from the first batch to the last acknowledgement.
async fn ingest(database: &Path, loads: Vec<Load>, clock: &SharedClock) -> f64 {
    let config = AggregatorConfig {
        listen: "tcp://127.0.0.1:0".into(),
        database: database.to_owned(),
        commit_nodes: COMMIT_NODES,
        ..AggregatorConfig::default()
    };
    let stop = CancellationToken::new();
    let running = Aggregator::start(config, Arc::clone(clock), stop.clone()).await.expect("starts");
    let address = running.handle.live().borrow().listening.clone();
    let mut agents = Vec::new();
    for load in loads {
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address.as_str()).await.expect("connects");
        socket.send(Message::single(Bytes::from(load.hello.clone()))).await.expect("sends");
        assert!(matches!(receive(&socket).await, ToAgent::Welcome { .. }));
        agents.push((socket, load));
    }
    let began = clock.mono();
    let tasks: Vec<_> = agents.into_iter().map(|(socket, load)| tokio::spawn(send(socket, load))).collect();
    for task in tasks {
        task.await.expect("sends everything");
    }
    let seconds = (clock.mono() - began).seconds();
    stop.cancel();
    running.join().await.expect("ends well");
    seconds
}

/// Keeps a window of batches under way until all are acknowledged; goes back where it is asked to.
async fn send(socket: Socket, load: Load) {
    let (mut next, mut stored) = (0, 0);
    while stored < load.frames.len() {
        while next < load.frames.len().min(stored + WINDOW) {
            socket.send(Message::single(load.frames[next].clone())).await.expect("sends");
            next += 1;
        }
        match receive(&socket).await {
            ToAgent::Ack { stream, through } if stream == load.stream => stored = through as usize,
            ToAgent::Resend { from, .. } => next = from as usize - 1,
            other => panic!("unexpected {other:?}"),
        }
    }
}

async fn receive(socket: &Socket) -> ToAgent {
    let message = socket.recv().await.expect("receives");
    decode(message.part_slice(0).expect("a frame")).expect("a message")
}

/// Seconds that a loop takes to insert the rows of one database into an empty one of the same schema.
async fn bare_loop(from: &Path, to: &Path, clock: &SharedClock) -> f64 {
    let mut source = SqliteConnectOptions::new().filename(from).connect().await.expect("opens");
    let mut tables = Vec::new();
    for table in ["iteration", "anchor", "transit", "node"] {
        let select = format!("SELECT * FROM {table}");
        let rows = sqlx::query(AssertSqlSafe(select)).fetch_all(&mut source).await.expect("reads");
        let rows: Vec<Vec<Cell>> = rows.iter().map(cells).collect();
        tables.push((table, rows));
    }
    let mut target = SqliteConnectOptions::new()
        .filename(to)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(false)
        .connect()
        .await
        .expect("opens");
    sqlx::migrate!("../../migrations").run_direct(None, &mut target, false).await.expect("makes the schema");
    let began = clock.mono();
    for (table, rows) in &tables {
        for transaction in rows.chunks(COMMIT_NODES) {
            sqlx::query("BEGIN").execute(&mut target).await.expect("begins");
            for statement in transaction.chunks(ROWS) {
                insert(&mut target, table, statement).await;
            }
            sqlx::query("COMMIT").execute(&mut target).await.expect("commits");
        }
    }
    let seconds = (clock.mono() - began).seconds();
    target.close().await.expect("closes");
    seconds
}

async fn insert(target: &mut SqliteConnection, table: &str, rows: &[Vec<Cell>]) {
    let columns = rows[0].len();
    let places = format!("({})", vec!["?"; columns].join(","));
    let sql = format!("INSERT INTO {table} VALUES {}", vec![places.as_str(); rows.len()].join(","));
    let mut arguments = SqliteArguments::default();
    arguments.reserve(columns * rows.len(), 0);
    for cell in rows.iter().flatten() {
        match cell {
            Cell::Null => arguments.add(None::<i64>),
            Cell::Integer(value) => arguments.add(*value),
            Cell::Real(value) => arguments.add(*value),
            Cell::Text(value) => arguments.add(value.as_str()),
        }
        .expect("encodes");
    }
    sqlx::query_with(AssertSqlSafe(sql), arguments).execute(target).await.expect("inserts");
}

enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
}

fn cells(row: &SqliteRow) -> Vec<Cell> {
    (0..row.len())
        .map(|at| {
            let raw = row.try_get_raw(at).expect("a column");
            match raw.type_info().name() {
                _ if raw.is_null() => Cell::Null,
                "INTEGER" => Cell::Integer(row.get(at)),
                "REAL" => Cell::Real(row.get(at)),
                _ => Cell::Text(row.get(at)),
            }
        })
        .collect()
}

async fn one(database: &Path, sql: &'static str) -> i64 {
    let mut connection = SqliteConnectOptions::new().filename(database).connect().await.expect("opens");
    sqlx::query_scalar(sql).fetch_one(&mut connection).await.expect("reads")
}
