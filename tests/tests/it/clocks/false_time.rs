//! Tests of a process under libfaketime, which does not know that its clock is wrong.

use peernet_clock::Span;
use peernet_tests::truth::{Delay, HostClock, Iteration};
use peernet_tests::{FalseTime, Network, Process, TwoHostTestbed};

use super::{WARM_UP, assert_contains_truth, print_line};

/// Offset of the edge's clock.
const AHEAD: Span = Span::from_millis(137);

/// Starts an edge with a false time, and a cloud with the kernel's clocks.
fn start(testbed: &TwoHostTestbed, false_time: &FalseTime, load: &str) -> (Process, Process) {
    let cloud = testbed.start_cloud("[clock]\ndiscipline = []\n");
    // The kernel's statements about its clock do not apply to the clock that libfaketime shows.
    let clock = "clock_identity = \"edge\"\n[clock]\ntimestamps = \"user\"\ndiscipline = []\n";
    let edge = testbed
        .start_edge(&format!("{clock}{}", testbed.pipeline("misled", 1000, load)), &false_time.environment());
    (cloud, edge)
}

#[test]
fn edge_with_false_time_reports_true_delays() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let false_time = FalseTime::new(testbed.folder(), AHEAD);
    let _hosts =
        start(&testbed, &false_time, "load = { mode = \"rate\", hz = 50.0 }\nlimit = { iterations = 300 }");
    testbed.wait_for_runs(1);
    let (edge, cloud) = (HostClock::ahead_by(&[AHEAD]), HostClock::of_kernel());
    let iterations = testbed.iterations();
    let (up, down) = assert_contains_truth("libfaketime +0.137 s", &iterations, &edge, &cloud);
    // The warm-up adds 5 iterations to the limit of 300.
    assert_eq!((up.compared, down.compared), (305, 305));
    // If the false time did not reach the program, the difference of the stamps would be positive.
    let stamp_differences: Vec<Span> =
        iterations.iter().map(|iteration| iteration.up.received - iteration.up.sent).collect();
    assert!(
        stamp_differences.iter().all(|difference| *difference > -AHEAD && *difference < Span::ZERO),
        "{stamp_differences:?}"
    );
}

/// Here the agent does not know of the step, in contrast to clock fault injection.
#[test]
fn unannounced_step_affects_no_delay() {
    /// Offset of the edge's clock after the step.
    const AHEAD_AFTER_STEP: Span = Span::from_millis(3_137);
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let false_time = FalseTime::new(testbed.folder(), AHEAD);
    let _hosts =
        start(&testbed, &false_time, "load = { mode = \"rate\", hz = 100.0 }\nlimit = { iterations = 1500 }");
    // The third window is that of the last 60 s.
    testbed.api.wait_until("/api/v1/pipelines/edge/misled", |pipeline| {
        (pipeline["windows"][2]["counts"]["ok"].as_f64()? >= 400.0).then_some(())
    });
    false_time.show(AHEAD_AFTER_STEP);
    testbed.wait_for_runs(1);

    let iterations = testbed.iterations();
    let (edge, cloud) = (HostClock::ahead_by(&[AHEAD, AHEAD_AFTER_STEP]), HostClock::of_kernel());
    assert_contains_truth("libfaketime, set by +3 s", &iterations, &edge, &cloud);
    let ahead = |iteration: &Iteration| iteration.up.sent - cloud.truth(iteration.up.received);
    let is_after_step = |iteration: &&Iteration| ahead(iteration) > Span::from_seconds(1);
    let first_after_step = iterations.iter().find(is_after_step).expect("the time that is shown was changed");
    let step_time = cloud.truth(first_after_step.up.received);
    let since_step = |iteration: &Iteration| cloud.truth(iteration.up.received) - step_time;
    let is_good = |delay: &Delay| ["ok", "limited"].contains(&delay.verdict.as_str());
    let settled = iterations.iter().filter(|iteration| iteration.number > WARM_UP);
    let not_good: Vec<_> =
        settled.filter(|iteration| !is_good(&iteration.up) || !is_good(&iteration.down)).collect();
    let times: Vec<Span> = not_good.iter().map(|iteration| since_step(iteration)).collect();
    print_line(&format!("libfaketime, set by +3 s: neither ok nor limited {times:?} after it"));
    let is_long_after_step = |iteration: &Iteration| since_step(iteration) > Span::from_seconds(5);
    assert!(iterations.iter().any(is_long_after_step), "the run ended within 5 s after the step");
    assert!(not_good.is_empty(), "{not_good:?}");
}
