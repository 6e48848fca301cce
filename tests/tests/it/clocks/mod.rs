//! Tests of one-way delays against the truth, over networks of namespaces.

mod address_translation;
mod assumptions;
mod asymmetric;
mod blocked;
mod calibration;
mod chrony;
mod false_time;
mod forged;
mod networks;
mod one_clock;
mod shaped;
mod slewed;
mod steps;
mod veth;

use peernet_tests::truth::{Comparison, HostClock, Iteration, compare};

/// Default number of warm-up iterations. Their delays may be `stale`, because there are fewer than
/// three exchanges at first.
const WARM_UP: u64 = 5;

/// Change of a clock's drift, ppm per second: the drift stays the same.
const CONSTANT_DRIFT: f64 = 0.0;

/// Returns a table that injects faults into a host's clock; `keys` are additional keys.
fn faults(offset_ms: f64, drift_ppm: f64, keys: &str) -> String {
    format!("[clock_fault]\noffset_ms = {offset_ms:?}\ndrift_ppm = {drift_ppm:?}\n{keys}\n")
}

/// Prints measured values; `--nocapture` shows them.
#[expect(clippy::print_stdout, reason = "the figures of a test are its output")]
fn print_line(figures: &str) {
    println!("{figures}");
}

/// Compares delays with the truth, prints the results of `case`, and checks every interval.
fn assert_contains_truth(
    case: &str,
    iterations: &[Iteration],
    edge: &HostClock,
    cloud: &HostClock,
) -> (Comparison, Comparison) {
    let (up, down) = compare(iterations, edge, cloud);
    for (direction, comparison) in [("upload", &up), ("download", &down)] {
        print_line(&format!("{case}, {direction}: {}", comparison.summary()));
        for description in &comparison.without_value {
            print_line(&format!("  without a value: {description}"));
        }
        assert!(comparison.outside.is_empty(), "{case}, {direction}:\n{}", comparison.outside.join("\n"));
    }
    (up, down)
}
