//! Tests of a wall clock that is set by three seconds during a run.

use peernet_clock::{Span, WallTime};
use peernet_tests::truth::{Delay, Iteration};
use peernet_tests::{Network, TwoHostTestbed};

use super::{WARM_UP, assert_contains_truth, faults};

/// Time of the step after the start of the agent.
const AT: Span = Span::from_seconds(8);

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stepped {
    Edge,
    Cloud,
}

fn step(stepped: Stepped, by_ms: i32) {
    let what = format!("{by_ms:+} ms on the {stepped:?}");
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let steps = format!("steps = [{{ at_s = {}, by_ms = {by_ms} }}]", AT.seconds());
    let table = |host, offset_ms| faults(offset_ms, 10.0, if host == stepped { &steps } else { "" });
    let _cloud = testbed.start_cloud(&table(Stepped::Cloud, 250.0));
    let load = "load = { mode = \"rate\", hz = 100.0 }\nlimit = { duration_s = 18.0 }";
    let pipeline = testbed.pipeline("stepped", 1000, load);
    let _edge = testbed.start_edge(&format!("{}{pipeline}", table(Stepped::Edge, -250.0)), &[]);
    let (edge, cloud) = (testbed.clock_of("edge"), testbed.clock_of("cloud"));
    testbed.wait_for_runs(1);

    let iterations = testbed.iterations();
    assert_contains_truth(&what, &iterations, &edge, &cloud);
    let clock = if stepped == Stepped::Edge { &edge } else { &cloud };
    let at = clock.since().expect("it has faults") + AT;
    // Times by the clock that was not stepped, because it shows no time twice.
    let when = |iteration: &Iteration| -> WallTime {
        match stepped {
            Stepped::Edge => cloud.truth(iteration.up.received),
            Stepped::Cloud => edge.truth(iteration.up.sent),
        }
    };
    let good = |delay: &Delay| ["ok", "limited"].contains(&delay.verdict.as_str());
    let all_good = |iteration: &&Iteration| good(&iteration.up) && good(&iteration.down);
    let second = Span::from_seconds(1);
    let before = |iteration: &&Iteration| iteration.number > WARM_UP && when(iteration) < at - second;
    let before: Vec<_> = iterations.iter().filter(before).collect();
    let after: Vec<_> = iterations.iter().filter(|iteration| when(iteration) >= at).collect();
    for settled in [before, after] {
        assert!(settled.len() >= 200, "{what}: {}", settled.len());
        for iteration in settled {
            assert!(all_good(&iteration), "{what}, {} after: {iteration:?}", when(iteration) - at);
        }
    }
}

#[test]
fn edge_clock_set_forward_affects_no_delay() {
    step(Stepped::Edge, 3_000);
}

#[test]
fn cloud_clock_set_forward_affects_no_delay() {
    step(Stepped::Cloud, 3_000);
}

#[test]
fn edge_clock_set_back_affects_no_delay() {
    step(Stepped::Edge, -3_000);
}

#[test]
fn cloud_clock_set_back_affects_no_delay() {
    step(Stepped::Cloud, -3_000);
}
