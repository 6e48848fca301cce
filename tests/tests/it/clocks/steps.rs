//! Tests of a wall clock that is set by three seconds during a run.

use peernet_clock::{Span, WallTime};
use peernet_tests::truth::{Delay, Iteration};
use peernet_tests::{Network, TwoHostTestbed};

use super::{WARM_UP, assert_contains_truth, faults};

/// Time of the step after the start of the agent.
const STEP_TIME: Span = Span::from_seconds(8);

#[derive(Clone, Copy, Debug, PartialEq)]
enum SteppedHost {
    Edge,
    Cloud,
}

fn check_step(stepped_host: SteppedHost, by_ms: i32) {
    let case = format!("{by_ms:+} ms on the {stepped_host:?}");
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let steps = format!("steps = [{{ at_s = {}, by_ms = {by_ms} }}]", STEP_TIME.seconds());
    let table = |host, offset_ms| faults(offset_ms, 10.0, if host == stepped_host { &steps } else { "" });
    let _cloud = testbed.start_cloud(&table(SteppedHost::Cloud, 250.0));
    let load = "load = { mode = \"rate\", hz = 100.0 }\nlimit = { duration_s = 18.0 }";
    let pipeline = testbed.pipeline("stepped", 1000, load);
    let _edge = testbed.start_edge(&format!("{}{pipeline}", table(SteppedHost::Edge, -250.0)), &[]);
    let (edge, cloud) = (testbed.clock_of("edge"), testbed.clock_of("cloud"));
    testbed.wait_for_runs(1);

    let iterations = testbed.iterations();
    assert_contains_truth(&case, &iterations, &edge, &cloud);
    let clock = if stepped_host == SteppedHost::Edge { &edge } else { &cloud };
    let step_time = clock.since().expect("it has faults") + STEP_TIME;
    // Times by the clock that was not stepped, because it shows no time twice.
    let time_of = |iteration: &Iteration| -> WallTime {
        match stepped_host {
            SteppedHost::Edge => cloud.truth(iteration.up.received),
            SteppedHost::Cloud => edge.truth(iteration.up.sent),
        }
    };
    let is_good = |delay: &Delay| ["ok", "limited"].contains(&delay.verdict.as_str());
    let are_both_good = |iteration: &&Iteration| is_good(&iteration.up) && is_good(&iteration.down);
    // An iteration that starts shortly before the step may end after it.
    let second = Span::from_seconds(1);
    let is_settled_before_step =
        |iteration: &&Iteration| iteration.number > WARM_UP && time_of(iteration) < step_time - second;
    let before: Vec<_> = iterations.iter().filter(is_settled_before_step).collect();
    let after: Vec<_> = iterations.iter().filter(|iteration| time_of(iteration) >= step_time).collect();
    for settled in [before, after] {
        assert!(settled.len() >= 200, "{case}: {}", settled.len());
        for iteration in settled {
            assert!(
                are_both_good(&iteration),
                "{case}, {} after: {iteration:?}",
                time_of(iteration) - step_time
            );
        }
    }
}

#[test]
fn edge_clock_set_forward_affects_no_delay() {
    check_step(SteppedHost::Edge, 3_000);
}

#[test]
fn cloud_clock_set_forward_affects_no_delay() {
    check_step(SteppedHost::Cloud, 3_000);
}

#[test]
fn edge_clock_set_back_affects_no_delay() {
    check_step(SteppedHost::Edge, -3_000);
}

#[test]
fn cloud_clock_set_back_affects_no_delay() {
    check_step(SteppedHost::Cloud, -3_000);
}
