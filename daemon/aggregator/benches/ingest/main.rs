//! Benchmark of ingest: nodes per second that reach the disk. Agents send over ZeroMQ to an aggregator; for comparison
//! a bare loop inserts the same rows in the order of their arrival into the same schema. Both sync each transaction
//! (`synchronous=FULL`). The aggregator, the agents and the bare loop run in separate processes.
//!
//! `cargo bench -p peernet-aggregator -- [NODES] [ROUNDS] [AGENTS…]`

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

mod bare;
#[path = "../../tests/it/generate.rs"]
#[expect(unreachable_pub, dead_code, reason = "shared with the tests")]
mod generate;
mod generator;
mod load;
mod server;

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Row};

use crate::load::LoadPlan;

#[tokio::main]
async fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let arguments_as_text: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments_as_text.as_slice() {
        ["server", database, commit_nodes] => server::run(Path::new(database), number(commit_nodes)).await,
        ["generator", address, agents, nodes] => {
            generator::run(address, &LoadPlan::new(number(agents), number(nodes)), None).await;
        }
        // `run_rounds` does not use this form. It is for measurements at a fixed rate, started by hand.
        ["generator", address, agents, nodes, speed] => {
            let speed: f64 = speed.parse().unwrap_or_else(|_| panic!("{speed:?} is not a speed"));
            generator::run(address, &LoadPlan::new(number(agents), number(nodes)), Some(speed)).await;
        }
        ["bare", from, to, agents, nodes] => {
            let plan = LoadPlan::new(number(agents), number(nodes));
            bare::run(Path::new(from), Path::new(to), &plan).await;
        }
        arguments_as_text => {
            let numbers: Vec<u64> = arguments_as_text.iter().map(|text| number(text)).collect();
            let (nodes, rounds) = (numbers.first().unwrap_or(&4_000_000), numbers.get(1).unwrap_or(&3));
            let agents = numbers.get(2..).filter(|agents| !agents.is_empty()).unwrap_or(&[1, 10, 1_000]);
            run_rounds(*nodes, *rounds, agents).await;
        }
    }
}

fn number(text: &str) -> u64 {
    text.parse().unwrap_or_else(|_| panic!("{text:?} is not a number"))
}

/// Runs all rounds and prints the table of results.
async fn run_rounds(nodes: u64, rounds: u64, agents: &[u64]) {
    // 0 stands for the aggregator's default.
    let commit_nodes = std::env::var("COMMIT_NODES").unwrap_or_else(|_| "0".to_owned());
    for agents in agents {
        let plan = LoadPlan::new(*agents, nodes);
        println!("{plan}");
        println!(
            "{:>5}  {:>18}  {:>17}  {:>5}  {:>10}  {:>9}  {:>4}",
            "round", "aggregator nodes/s", "bare loop nodes/s", "ratio", "bytes/node", "peak MiB", "lost"
        );
        for round in 1..=rounds {
            let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
            let (aggregator_database, bare_database) =
                (folder.path().join("aggregator.sqlite"), folder.path().join("bare.sqlite"));
            let (agents, nodes) = (agents.to_string(), nodes.to_string());
            let mut server = Role::start(&["server", path_text(&aggregator_database), &commit_nodes]);
            let address = server.read_line();
            let mut generator = Role::start(&["generator", &address, &agents, &nodes]);
            let seconds: f64 = generator.read_line().parse().expect("seconds");
            generator.end();
            let peak = server.peak_kib() as f64 / 1024.0;
            server.end();
            let mut bare_loop = Role::start(&[
                "bare",
                path_text(&aggregator_database),
                path_text(&bare_database),
                &agents,
                &nodes,
            ]);
            let bare_seconds: f64 = bare_loop.read_line().parse().expect("seconds");
            bare_loop.end();
            let stored = query_number(&aggregator_database, "SELECT count(*) FROM node").await;
            let bytes = query_number(
                &aggregator_database,
                "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size",
            )
            .await;
            let (rate, bare_rate) = (stored as f64 / seconds, stored as f64 / bare_seconds);
            println!(
                "{round:>5}  {rate:>18.0}  {bare_rate:>17.0}  {:>5.2}  {:>10.1}  {peak:>9.0}  {:>4}",
                rate / bare_rate,
                bytes as f64 / stored as f64,
                plan.nodes() as i64 - stored
            );
        }
    }
}

fn path_text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

/// Runs a query and returns its only value.
async fn query_number(database: &Path, sql: &'static str) -> i64 {
    let options = SqliteConnectOptions::new().filename(database);
    let mut connection = options.connect().await.expect("opens");
    sqlx::query(sql).fetch_one(&mut connection).await.expect("reads").get(0)
}

/// This program in another role, as a child process. The child prints its results on its standard output, and ends when
/// its standard input is closed.
struct Role {
    child: Child,
    input: Option<ChildStdin>,
    lines: BufReader<ChildStdout>,
}

impl Role {
    fn start(arguments: &[&str]) -> Self {
        let program = std::env::current_exe().expect("this program");
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("starts");
        let lines = BufReader::new(child.stdout.take().expect("piped"));
        Self { input: child.stdin.take(), child, lines }
    }

    /// Reads the next line that the child prints.
    fn read_line(&mut self) -> String {
        let mut line = String::new();
        self.lines.read_line(&mut line).expect("reads");
        line.trim().to_owned()
    }

    /// Returns the peak of the child's resident memory, KiB.
    fn peak_kib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a peak");
        number(line.trim().trim_end_matches(" kB"))
    }

    /// Closes the child's input and waits for its end.
    fn end(mut self) {
        drop(self.input.take());
        assert!(self.child.wait().expect("ends").success(), "a part of the benchmark failed");
    }
}

/// Reports a line to the parent process.
fn report(line: impl std::fmt::Display) {
    println!("{line}");
    std::io::stdout().flush().expect("the parent process reads");
}
