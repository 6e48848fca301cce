//! Benchmark of the time that a call of a Python object takes outside custom code, compared with the time that the same
//! bytes take through bare pipes.
//!
//!     cargo bench -p peernet-external --bench python -- [--json] [ROUNDS]
//!
//! *bytes* and *array* are passed to an object that returns its argument. *cat* passes the bytes to the program `cat`,
//! which `Process` runs, as it runs the Python object. The time of *cat* is the least that two pipes and two process
//! switches cost.

use std::fs;
use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_external::process::{Launch, Process, StderrLog};
use peernet_external::python::{PythonConfig, PythonObject, Role};
use peernet_sample::{Description, ElementType, MediaType, Part};

const SIZES: [usize; 3] = [1_000, 150_000, 1_200_000];
const ECHO: &str = "class Echo:\n    def infer(self, x): return x\n";
const TIMEOUT: Span = Span::from_seconds(60);

#[expect(clippy::print_stdout, reason = "a benchmark prints its table")]
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let json = arguments.iter().any(|argument| argument == "--json");
    let rounds = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(2000);
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", ClockIdentity::SYSTEM)));
    let mut rows = Vec::new();
    for size in SIZES {
        let content = Bytes::from(vec![7; size]);
        let array = Description {
            media: MediaType::Tensor,
            shape: vec![u32::try_from(size).expect("is small")],
            element: Some(ElementType::U8),
        };
        rows.push(("cat", size, measure_cat(&content, rounds, &clock)));
        for (name, description) in [("bytes", Description::bytes()), ("array", array)] {
            let part = Part { description, bytes: content.clone() };
            rows.push((name, size, measure_echo(&part, rounds, &clock)));
        }
    }
    if json {
        let rows = rows.iter().map(|(name, size, [p50, p99])| {
            serde_json::json!({ "what": name, "bytes": size, "p50_s": p50, "p99_s": p99 })
        });
        println!("{}", serde_json::Value::from_iter(rows));
        return;
    }
    println!("{:<8}{:>12}{:>10}{:>10}   µs per round trip, {rounds} rounds", "", "bytes", "p50", "p99");
    for (name, size, [p50, p99]) in rows {
        println!("{name:<8}{size:>12}{:>10.1}{:>10.1}", p50 * 1e6, p99 * 1e6);
    }
}

/// Measures the time of each call outside custom code; returns its p50 and p99 in seconds.
fn measure_echo(part: &Part, rounds: usize, clock: &SharedClock) -> [f64; 2] {
    let folder = tempfile::tempdir().expect("there is room for a folder");
    fs::write(folder.path().join("echo.py"), ECHO).expect("it can be written");
    let mut config = PythonConfig::new("echo::Echo");
    config.folder = Some(folder.path().to_owned());
    let device = None;
    let mut object = PythonObject::start(&config, Role::Model, "bench", device, clock).expect("it starts");
    let parts = std::slice::from_ref(part);
    let mut durations = Vec::with_capacity(rounds);
    // The first rounds warm up and are not measured.
    for round in 0..rounds + rounds / 10 {
        let object_call = object.call(parts);
        assert_eq!(object_call.result.expect("it answers").as_deref(), Some(parts));
        if round >= rounds / 10 {
            durations.push(object_call.times.overhead().seconds());
        }
    }
    quantiles(durations)
}

/// Measures the time to write to `cat` and read the same bytes back; returns its p50 and p99 in seconds.
fn measure_cat(content: &Bytes, rounds: usize, clock: &SharedClock) -> [f64; 2] {
    let launch = Launch {
        name: "cat".to_owned(),
        stderr_log: StderrLog::Exec,
        program: "cat".into(),
        arguments: Vec::new(),
        folder: None,
        environment: Default::default(),
        inherited_file: None,
    };
    let mut process = Process::start(&launch, clock).expect("cat is there");
    let mut durations = Vec::with_capacity(rounds);
    // The first rounds warm up and are not measured.
    for round in 0..rounds + rounds / 10 {
        let started_at = clock.mono();
        process.write(&[content], started_at + TIMEOUT).expect("it reads");
        let echoed_bytes = process.read_exact(content.len(), started_at + TIMEOUT).expect("it writes");
        let span = clock.mono() - started_at;
        assert_eq!(echoed_bytes.len(), content.len());
        if round >= rounds / 10 {
            durations.push(span.seconds());
        }
    }
    quantiles(durations)
}

/// Returns the p50 and p99 of durations.
fn quantiles(mut durations: Vec<f64>) -> [f64; 2] {
    durations.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|p| durations[((durations.len() - 1) as f64 * p) as usize])
}
