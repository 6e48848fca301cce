//! Test of the memory of an aggregator that stores for a long time.

use std::time::Duration;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::{Fleet, Stopwatch, record_measurements};

use super::setting;

/// Limit of the anonymous resident memory that [measurements.md](../../../../docs/measurements.md)
/// states for eight pipelines and an open page.
const MAX_RESIDENT_MIB: f64 = 192.0;

/// Returns the anonymous resident memory of a process, MiB.
fn memory_mib(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("the process runs");
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("Linux reports RssAnon");
    let kib: f64 = line.trim().trim_end_matches(" kB").parse().expect("a number");
    kib / 1024.0
}

#[test]
#[ignore = "takes as long as PEERNET_MEMORY_S says; for make soak"]
fn memory_stays_below_documented_limit() {
    let seconds = setting("PEERNET_MEMORY_S", 600);
    let pipelines: String =
        (0..8).map(|number| echo_pipeline(&format!("loop-{number}"), &rate_load(200.0))).collect();
    let mut fleet = Fleet::new(&["edge"], &agent_configuration("", &pipelines));
    fleet.start(0);
    let (pid, stopwatch) = (fleet.aggregator.process().pid(), Stopwatch::start());
    let mut samples = Vec::new();
    while stopwatch.elapsed() < Duration::from_secs(seconds) {
        // Pages are part of the load.
        fleet.api.get("/").expect("the dashboard answers");
        fleet.api.get("/runs/1").expect("the dashboard answers");
        samples.push(memory_mib(pid));
        std::thread::sleep(Duration::from_secs(1));
    }
    let maximum = samples.iter().copied().fold(0.0, f64::max);
    let halfway = samples[samples.len() / 2];
    let last = samples.last().copied().expect("some");
    let mib = |value: f64| format!("{value:.1} MiB");
    record_measurements(
        "aggregator's memory, 8 pipelines at 200 Hz",
        &[("halfway", mib(halfway)), ("at the end", mib(last)), ("at the most", mib(maximum))],
    );
    assert!(maximum < MAX_RESIDENT_MIB, "{maximum} MiB of at most {MAX_RESIDENT_MIB}: {samples:?}");
    fleet.stop();
}
