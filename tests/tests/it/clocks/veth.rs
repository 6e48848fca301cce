//! Tests of two hosts on one cable, whose clocks are a second apart and drift: the delays must not change.

use peernet_clock::Span;
use peernet_tests::truth::HostClock;
use peernet_tests::{Network, TwoHostTestbed};

use super::{WARM_UP, assert_contains_truth, faults};

/// Largest mean error of each direction.
const MAX_MEAN_ERROR: Span = Span::from_micros(50);

/// Number of iterations of the steady pipeline: 20 s at 100 Hz. At 50 ppm, clocks drift apart by
/// 1 ms in this time.
const STEADY_ITERATIONS: usize = 2_000;
/// Number of iterations of the pipeline that runs as fast as it can.
const QUICK_ITERATIONS: usize = 1_000;

#[derive(Clone, Copy)]
enum WrongClock {
    Edge,
    Cloud,
}

/// Runs a steady pipeline, slow enough that the clocks drift apart meanwhile, and one that runs as fast as it can.
fn check_case(offset_ms: f64, drift_ppm: f64, max_drift_ppm: f64, wrong_clock: WrongClock) {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let clock = format!("[clock]\nmax_drift_ppm = {max_drift_ppm:?}\n");
    let fault = faults(offset_ms, drift_ppm, "");
    let (edge_fault, cloud_fault) = match wrong_clock {
        WrongClock::Edge => (fault.as_str(), ""),
        WrongClock::Cloud => ("", fault.as_str()),
    };
    let _cloud = testbed.start_cloud(&format!("{clock}{cloud_fault}"));
    let steady =
        format!("load = {{ mode = \"rate\", hz = 100.0 }}\nlimit = {{ iterations = {STEADY_ITERATIONS} }}");
    let quick = format!("limit = {{ iterations = {QUICK_ITERATIONS} }}");
    let pipelines =
        [testbed.pipeline("steady", 1000, &steady), testbed.pipeline("quick", 1000, &quick)].concat();
    let _edge = testbed.start_edge(&format!("{clock}{edge_fault}{pipelines}"), &[]);

    let (edge, cloud) = match wrong_clock {
        WrongClock::Edge => (testbed.clock_of("edge"), HostClock::of_kernel()),
        WrongClock::Cloud => (HostClock::of_kernel(), testbed.clock_of("cloud")),
    };
    testbed.wait_for_runs(2);
    let case = format!("{offset_ms:+} ms, {drift_ppm:+} ppm of {max_drift_ppm}");
    let (up, down) = assert_contains_truth(&case, &testbed.iterations(), &edge, &cloud);
    for comparison in [&up, &down] {
        assert_eq!(comparison.compared, STEADY_ITERATIONS + QUICK_ITERATIONS + 2 * WARM_UP as usize);
        assert!(comparison.mean_error() <= MAX_MEAN_ERROR, "{case}: {}", comparison.summary());
    }
}

#[test]
fn delays_contain_truth_for_fast_cloud_ahead() {
    check_case(1_000.0, 50.0, 50.0, WrongClock::Cloud);
}

#[test]
fn delays_contain_truth_for_slow_edge_behind() {
    check_case(-1_000.0, -50.0, 50.0, WrongClock::Edge);
}

#[test]
fn delays_contain_truth_for_fast_edge_ahead() {
    check_case(1_000.0, 100.0, 150.0, WrongClock::Edge);
}

#[test]
fn delays_contain_truth_for_slow_cloud_behind() {
    check_case(-1_000.0, -100.0, 150.0, WrongClock::Cloud);
}
