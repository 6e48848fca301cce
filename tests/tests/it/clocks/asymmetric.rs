//! Tests on a path with 40 ms up and 5 ms down, jitter and loss: the bounds of two-way exchanges, and the additional
//! information from disciplined clocks.

use std::path::Path;

use peernet_clock::Span;
use peernet_tests::TwoHostTestbed;
use peernet_tests::network::{Network, WireProperties};
use peernet_tests::truth::{Delay, HostClock, Iteration};

use super::{WARM_UP, assert_contains_truth, faults, print_line};

fn wire(folder: &Path) -> Network {
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 5, loss_percent: 2 };
    Network::wire(folder, wire_direction(40), wire_direction(5))
}

/// Result of 300 iterations.
struct Outcome {
    iterations: Vec<Iteration>,
    edge: HostClock,
    cloud: HostClock,
    is_jump_suspected: bool,
}

/// Runs 300 iterations with faults injected into both clocks; the claims of their time daemons are trusted.
fn run(discipline: &str) -> Outcome {
    let testbed = TwoHostTestbed::new(wire);
    let discipline = format!("discipline = \"{discipline}\"");
    let _cloud = testbed.start_cloud(&faults(700.0, -20.0, &discipline));
    let load = "load = { mode = \"rate\", hz = 20.0 }\nlimit = { iterations = 300 }\nmax_in_flight = 64";
    let pipeline = testbed.pipeline("far", 1000, load);
    let _edge = testbed.start_edge(
        &format!("[clock]\ntrust_time_daemons = true\n{}{pipeline}", faults(-300.0, 20.0, &discipline)),
        &[],
    );
    let (edge, cloud) = (testbed.clock_of("edge"), testbed.clock_of("cloud"));
    testbed.wait_for_runs(1);
    let iterations = testbed.iterations();
    assert!(iterations.len() >= 300, "{}", iterations.len());
    let is_jump_suspected = testbed.api.json("/api/v1/incidents").to_string().contains("clock-step");
    Outcome { iterations, edge, cloud, is_jump_suspected }
}

/// Checks the verdict of a delay: `ok` if its interval is at most half as wide as the delay, else `limited`. After a suspected
/// jump, which jitter causes now and then, a delay with a narrow interval is also `limited` for 10 s.
fn assert_verdict_matches_bounds(delay: &Delay, is_jump_suspected: bool) {
    let (value, (lo, hi)) = (delay.value.expect("a value"), delay.bounds.expect("bounds"));
    let is_wide = (hi - lo).nanos() * 2 > value.nanos();
    let allowed_verdicts = match (is_wide, is_jump_suspected) {
        (true, _) => ["limited"].as_slice(),
        (false, false) => &["ok"],
        (false, true) => &["ok", "limited"],
    };
    assert!(allowed_verdicts.contains(&delay.verdict.as_str()), "{delay:?}");
}

#[test]
fn interval_width_is_within_smallest_round_trip() {
    let Outcome { iterations, edge, cloud, is_jump_suspected } = run("none");
    let (up, down) = assert_contains_truth("40 ms up, 5 ms down, no discipline", &iterations, &edge, &cloud);
    let round_trips = iterations.iter().map(|iteration| {
        let edge_time = edge.truth(iteration.down.received) - edge.truth(iteration.up.sent);
        edge_time - (cloud.truth(iteration.down.sent) - cloud.truth(iteration.up.received))
    });
    let smallest = round_trips.min().expect("there are iterations");
    print_line(&format!("smallest round trip of data {smallest}"));
    for comparison in [&up, &down] {
        assert!(comparison.without_value.is_empty());
        assert!(
            comparison.width_quantile(0.5) <= smallest + Span::from_millis(1),
            "{}",
            comparison.summary()
        );
    }
    let settled = iterations.iter().filter(|iteration| iteration.number > WARM_UP);
    for iteration in settled {
        assert_verdict_matches_bounds(&iteration.up, is_jump_suspected);
        assert_verdict_matches_bounds(&iteration.down, is_jump_suspected);
    }
    // The download is shorter than the asymmetry that cannot be excluded, so its interval is too wide for `ok`.
    assert!(iterations.iter().any(|iteration| iteration.down.verdict == "limited"));
}

#[test]
fn disciplined_clocks_narrow_delay_bounds() {
    let Outcome { iterations, edge, cloud, is_jump_suspected } = run("exact");
    let (up, down) =
        assert_contains_truth("40 ms up, 5 ms down, exact discipline", &iterations, &edge, &cloud);
    for comparison in [&up, &down] {
        assert!(comparison.without_value.is_empty());
        assert!(comparison.error_quantile(1.0) <= Span::from_millis(1), "{}", comparison.summary());
    }
    // The first iterations may be answered before there are three exchanges, and are `stale` then.
    for iteration in iterations.iter().filter(|iteration| iteration.number > WARM_UP) {
        assert_verdict_matches_bounds(&iteration.up, is_jump_suspected);
        assert_verdict_matches_bounds(&iteration.down, is_jump_suspected);
        assert!(is_jump_suspected || iteration.up.verdict == "ok", "{:?}", iteration.up);
    }
}
