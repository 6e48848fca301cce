//! Tests of two processes on one machine and in one network namespace: their offset is zero only if they prove that
//! they read the same clock.

use std::path::Path;
use std::time::Duration;

use peernet_clock::{ClockFaults, RawTime, Span, WallTime};
use peernet_tests::truth::{HostClock, Iteration, iterations};
use peernet_tests::{Api, FalseTime, LoopbackDeployment, Process, Stopwatch, program, wait_until_grown};
use rustix::process::Signal;
use serde_json::Value;

use super::{WARM_UP, assert_contains_truth, print_line};

/// Offset of the edge's clock in tests in which the hosts read different clocks.
const AHEAD: Span = Span::from_millis(20);
const ITERATIONS: u64 = 300;
/// Longest time between the readings of the two clocks of a stamp, by a process under libfaketime,
/// which makes each reading slower.
const MAX_READ_DISTANCE: Span = Span::from_micros(5);

/// Clock identity of both hosts. Without it a host with clock fault injection would have another identity.
const IDENTITY: &str = "clock_identity = \"machine\"\n";

const CLOUD: &str = "[clock]\ndiscipline = []\n[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\n\
    [[model]]\nname = \"echo\"\nkind = \"echo\"\n";

/// End of the edge's run.
#[derive(Clone, Copy)]
enum RunEnd {
    /// After [`ITERATIONS`].
    Limit,
    /// When the edge is stopped.
    Stop,
}

/// An aggregator, a cloud that reads the kernel's clocks, and the folder of an edge.
struct Hosts {
    deployment: LoopbackDeployment,
    api: Api,
    _aggregator: Process,
    _cloud: Process,
}

impl Hosts {
    /// Starts aggregator and cloud, and writes the configuration of the edge with these additional tables.
    fn new(tables: &str, end: RunEnd) -> Self {
        let deployment = LoopbackDeployment::new();
        let (aggregator, api) = deployment.start_aggregator();
        let cloud = deployment.start_agent("cloud", &format!("{IDENTITY}{CLOUD}"));
        let limit = match end {
            RunEnd::Limit => format!("limit = {{ iterations = {ITERATIONS} }}\n"),
            RunEnd::Stop => String::new(),
        };
        let edge = format!(
            "[agent]\nname = \"edge\"\nstate_dir = \"{{folder}}/edge\"\naggregator = \"tcp://127.0.0.1:{{events}}\"\n\
             {IDENTITY}{tables}[[pipeline]]\nname = \"line\"\nsensor = {{ kind = \"synthetic\", size_bytes = 1000 }}\n\
             placement = {{ kind = \"remote\", peer = \"tcp://127.0.0.1:{{data}}\", model = \"echo\" }}\n\
             load = {{ mode = \"rate\", hz = 50.0 }}\n{limit}"
        );
        deployment.write("edge.toml", &edge);
        Self { deployment, api, _aggregator: aggregator, _cloud: cloud }
    }

    /// Waits until probes on the link are answered, and returns the live state of the link.
    fn wait_for_link(&self) -> Value {
        self.api.wait_until("/api/v1/links", |links| {
            let now = &links["links"][0]["now"];
            (now["same_clock"].is_boolean() && now["offset"].is_object()).then(|| now.clone())
        })
    }

    /// Returns all iterations after the end of the run.
    fn iterations(&self) -> Vec<Iteration> {
        self.api.wait_for_finished_run();
        iterations(&self.deployment.folder().join("aggregator.sqlite"))
    }
}

/// Compares delays between hosts with two clocks with the truth. Every delay must come from exchanges.
fn assert_measured(case: &str, iterations: &[Iteration], edge: &HostClock) {
    let (up, down) = assert_contains_truth(case, iterations, edge, &HostClock::of_kernel());
    let count = usize::try_from(ITERATIONS + WARM_UP).expect("a few hundred");
    assert_eq!((up.compared, down.compared), (count, count));
    for iteration in iterations {
        for delay in [&iteration.up, &iteration.down] {
            assert_eq!(delay.source, "in-band", "{delay:?}");
        }
    }
}

/// Returns a free-running clock that is always ahead of the kernel's by this offset.
fn raw_ahead_by(offset: Span) -> HostClock {
    let (steps, since) = (Vec::new(), WallTime::default());
    // Without drift and steps the beginning does not matter.
    HostClock::new(ClockFaults { offset, drift_ppm: 0.0, steps, since }, RawTime::default())
}

#[test]
fn processes_on_one_machine_prove_one_clock() {
    let hosts = Hosts::new("", RunEnd::Limit);
    let _edge = hosts.deployment.start("edge.toml");
    let iterations = hosts.iterations();
    let (up, _) =
        assert_contains_truth("one clock", &iterations, &HostClock::of_kernel(), &HostClock::of_kernel());
    assert_eq!(up.compared, usize::try_from(ITERATIONS + WARM_UP).expect("a few hundred"));
    for iteration in &iterations {
        for delay in [&iteration.up, &iteration.down] {
            assert_eq!((delay.source.as_str(), delay.verdict.as_str()), ("same-clock", "ok"), "{delay:?}");
        }
    }
}

/// Both hosts read the same boot id, but libfaketime changes all clocks of the edge: the wall clock
/// is 20 ms ahead, and the error of the free-running clock is unknown.
#[test]
fn interval_contains_truth_for_process_with_false_time() {
    let hosts = Hosts::new("[clock]\ntimestamps = \"user\"\ndiscipline = []\n", RunEnd::Limit);
    let false_time = FalseTime::new(&hosts.deployment.folder().join("time"), AHEAD);
    // Without this variable libfaketime also changes the free-running clock.
    let environment: Vec<_> =
        false_time.environment().into_iter().filter(|(name, _)| *name != "DONT_FAKE_MONOTONIC").collect();
    let _edge = hosts.deployment.start_with("edge.toml", &environment);
    assert_eq!(hosts.wait_for_link()["same_clock"], false);
    let iterations = hosts.iterations();
    let mut widest = Span::ZERO;
    for iteration in &iterations {
        // Only the error of the wall clock is known, so the truth is derived from its stamps.
        for (delay, error) in [(&iteration.up, AHEAD), (&iteration.down, -AHEAD)] {
            let truth = delay.received - delay.sent + error;
            let (lo, hi) = delay.bounds.unwrap_or_else(|| panic!("no bounds: {delay:?}"));
            assert_eq!(delay.source, "in-band", "{delay:?}");
            assert!(
                lo - MAX_READ_DISTANCE <= truth && truth <= hi + MAX_READ_DISTANCE,
                "{truth} of {delay:?}"
            );
            widest = widest.max(hi - lo);
        }
    }
    assert_eq!(iterations.len() as u64, ITERATIONS + WARM_UP);
    print_line(&format!(
        "libfaketime, all clocks: {} iterations, none outside, widest {widest}",
        iterations.len()
    ));
}

#[test]
fn clock_error_introduced_later_is_measured_afterwards() {
    let hosts = Hosts::new("[clock]\ntimestamps = \"user\"\ndiscipline = []\n", RunEnd::Stop);
    let false_time = FalseTime::new(&hosts.deployment.folder().join("time"), Span::ZERO);
    let _edge = hosts.deployment.start_with("edge.toml", &false_time.environment());
    let wait_until_same_clock_is = |expected: bool| {
        hosts.api.wait_until("/api/v1/links", |links| {
            (links["links"][0]["now"]["same_clock"] == expected).then_some(())
        });
    };
    wait_until_same_clock_is(true);
    let stopwatch = Stopwatch::start();
    false_time.show(AHEAD);
    wait_until_same_clock_is(false);
    print_line(&format!("libfaketime begins to show +20 ms: noticed within {:?}", stopwatch.elapsed()));
    let incident = hosts.api.wait_until("/api/v1/incidents", |list| {
        let reports_lost_proof =
            |incident: &&Value| incident["text"].to_string().contains("it is no longer proven");
        list["incidents"].as_array()?.iter().find(reports_lost_proof).cloned()
    });
    let text = incident["text"].to_string();
    assert!(
        text.contains("edge and cloud") && text.contains("a preloaded library shows this process"),
        "{incident}"
    );
    assert_eq!(
        (&incident["kind"], &incident["host"], &incident["peer"]),
        (&"clock-step".into(), &"edge".into(), &"cloud".into())
    );
    false_time.show(Span::ZERO);
    wait_until_same_clock_is(true);
}

/// The edge sends its query for the proof late because it was paused. This does not indicate another clock.
#[test]
fn paused_process_keeps_one_clock_proof() {
    let hosts = Hosts::new("[clock]\ndiscipline = []\n", RunEnd::Stop);
    let edge = hosts.deployment.start("edge.toml");
    let successful_iterations =
        || hosts.api.wait_until("/api/v1/runs", |runs| runs["runs"][0]["counts"]["ok"].as_u64());
    for _ in 0..3 {
        let before = successful_iterations();
        wait_until_grown("iterations", before + 100, || Some(successful_iterations()));
        edge.signal(Signal::STOP);
        // A proof may expire during this pause: it is valid for five seconds, and the last query may be two seconds
        // old. The pause is shorter than a session's timeout.
        std::thread::sleep(Duration::from_millis(4_500));
        edge.signal(Signal::CONT);
    }
    let before = successful_iterations();
    wait_until_grown("iterations", before + 100, || Some(successful_iterations()));
    assert_eq!(hosts.wait_for_link()["same_clock"], true);
    assert_eq!(edge.stop().code(), 0);
    let incidents = hosts.api.json("/api/v1/incidents").to_string();
    assert!(!incidents.contains("clock-step"), "{incidents}");
    // The list has the other incidents, so it would have a clock step, too.
    assert!(incidents.contains("connected"), "{incidents}");
}

/// A time namespace shifts the free-running clock by ten seconds, but not the wall clock.
#[test]
fn interval_contains_truth_in_other_time_namespace() {
    let hosts = Hosts::new("[clock]\ndiscipline = []\n", RunEnd::Limit);
    let peernetd = program("peernetd").display().to_string();
    let arguments =
        ["--time", "--monotonic", "10", "--boottime", "10", &peernetd, "run", "edge.toml"].map(str::to_owned);
    let _edge = Process::start(Path::new("unshare"), &arguments, hosts.deployment.folder(), &[]);
    assert_eq!(hosts.wait_for_link()["same_clock"], false);
    assert_measured("another time namespace", &hosts.iterations(), &raw_ahead_by(Span::from_seconds(10)));
}

#[test]
fn interval_contains_truth_with_clock_fault_injection() {
    let hosts = Hosts::new(&super::faults(20.0, 0.0, ""), RunEnd::Limit);
    let _edge = hosts.deployment.start("edge.toml");
    assert_eq!(hosts.wait_for_link()["same_clock"], false);
    assert_measured("clock fault of 20 ms", &hosts.iterations(), &raw_ahead_by(AHEAD));
}
