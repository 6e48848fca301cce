//! Benchmark of calls of an external program, which is written in C and answers with the received bytes.
//!
//!     cargo bench -p peernet-external --bench exec -- [--json] [ROUNDS]

use std::fs;
use std::process::Command;
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_external::exec::{CommandLine, ExecConfig, Program, ReplyOutcome, Request, Role};
use peernet_sample::{Description, Sample};

const SIZES: [usize; 3] = [1_000, 150_000, 1_200_000];
const ECHO: &str = r#"
#include <stdio.h>
static char line[8192], bytes[4 << 20];
int main(void) {
    size_t n;
    while (fgets(line, sizeof line, stdin) && sscanf(line, "%*s %zu", &n) == 1 && n <= sizeof bytes) {
        if (fread(bytes, 1, n, stdin) != n) return 1;
        printf("answer %zu\n", n);
        fwrite(bytes, 1, n, stdout);
        fflush(stdout);
    }
}
"#;

#[expect(clippy::print_stdout, reason = "a benchmark prints its table")]
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let json = arguments.iter().any(|argument| argument == "--json");
    let rounds = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(2000);
    let folder = tempfile::tempdir().expect("there is room for a folder");
    let (source, program) = (folder.path().join("echo.c"), folder.path().join("echo"));
    fs::write(&source, ECHO).expect("it can be written");
    let compilation = Command::new("cc").arg("-O2").arg("-o").arg(&program).arg(&source).status();
    assert!(compilation.expect("a C compiler is there").success());
    let config = ExecConfig::new(CommandLine::Words(vec![program.display().to_string()]));

    let rows = SIZES.map(|size| (size, measure_calls(&config, size, rounds)));
    if json {
        let rows = rows.iter().map(|(size, [p50, p99])| {
            serde_json::json!({ "what": "exec", "bytes": size, "p50_s": p50, "p99_s": p99 })
        });
        println!("{}", serde_json::Value::from_iter(rows));
        return;
    }
    println!("{:>12}{:>10}{:>10}   µs per round trip, {rounds} rounds", "bytes", "p50", "p99");
    for (size, [p50, p99]) in rows {
        println!("{size:>12}{:>10.1}{:>10.1}", p50 * 1e6, p99 * 1e6);
    }
}

/// Measures the time from request to reply; returns its p50 and p99 in seconds.
fn measure_calls(config: &ExecConfig, size: usize, rounds: usize) -> [f64; 2] {
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", ClockIdentity::SYSTEM)));
    let mut program = Program::start(config, Role::Model, "bench", &clock).expect("it starts");
    let sample = Sample::from_part(Description::bytes(), vec![7; size].into());
    // The first calls warm up and are not measured.
    let mut durations: Vec<f64> = (0..rounds + rounds / 10)
        .map(|_| {
            let program_call = program.call(Request::Sample(&sample)).expect("it answers");
            assert!(matches!(&program_call.outcome, ReplyOutcome::Parts(parts) if *parts == sample.parts));
            program_call.duration().seconds()
        })
        .skip(rounds / 10)
        .collect();
    durations.sort_unstable_by(f64::total_cmp);
    [0.5, 0.99].map(|p| durations[((durations.len() - 1) as f64 * p).round() as usize])
}
