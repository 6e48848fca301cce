//! Tests with clocks that drift within the limits, on paths of all kinds: every interval contains the truth.

use peernet_clock::Span;
use peernet_tests::ClockShim;
use peernet_tests::network::WireProperties;

use super::{CONSTANT_DRIFT, ClockTestbed, wire_direction, wire_network};

/// Runs a case for this time after the window is full, and checks every interval.
fn check_case(
    case: &'static str,
    [up, down]: [WireProperties; 2],
    duration_s: i64,
    prepare: impl FnOnce([&ClockShim; 2]),
) {
    let testbed = ClockTestbed::new(case, wire_network(up, down), "", prepare);
    let settled = testbed.wait_for_full_window();
    testbed.wait_until_stored_to(settled + Span::from_seconds(duration_s));
    let outcome = testbed.end();
    outcome.assert_never_wrong();
    outcome.assert_good_at_end();
}

/// Returns the preparation of a constant drift between the two hosts.
fn constant_drift(ppm: f64) -> impl FnOnce([&ClockShim; 2]) {
    move |[edge, cloud]| {
        edge.schedule_change(Span::from_seconds(-5), ppm / 2.0, CONSTANT_DRIFT);
        // The rate of one clock, measured by the other clock, exceeds the difference of both true
        // rates slightly. The factor keeps the measured rate within `ppm`.
        cloud.schedule_change(Span::from_seconds(9), -ppm / 2.0 * 0.9997, CONSTANT_DRIFT);
    }
}

/// Simulates a crystal that is warmed and cooled: its rate stays within `ppm` of nominal and changes by `ppm_per_s`.
fn schedule_temperature_cycles(shim: &ClockShim, ppm: f64, ppm_per_s: f64, duration_s: f64) {
    let half_period = 2.0 * ppm / ppm_per_s;
    let mut begin = shim.schedule_change(Span::from_seconds(1_234), -ppm, ppm_per_s);
    let half_cycles = (duration_s / half_period).ceil() as u32;
    for half_cycle in 1..=half_cycles {
        begin = begin + Span::from_seconds_f64(half_period);
        // The rate rises from `-ppm` to `ppm`, or falls from `ppm` to `-ppm`.
        let direction = if half_cycle % 2 == 0 { 1.0 } else { -1.0 };
        shim.schedule_change_at(begin, Span::ZERO, -direction * ppm, direction * ppm_per_s);
    }
}

#[test]
fn intervals_are_right_at_200_ppm() {
    check_case("+200 ppm, 1/1 ms", [wire_direction(1, 0, 0); 2], 10, constant_drift(200.0));
}

#[test]
fn intervals_hold_at_200_ppm_on_bad_path() {
    let wire_directions = [wire_direction(5, 3, 2), wire_direction(40, 3, 2)];
    check_case("-200 ppm, 5/40 ms, 3 ms of jitter, 2 % lost", wire_directions, 10, constant_drift(-200.0));
}

#[test]
fn intervals_are_right_with_temperature_changes() {
    // A degree per second at 1 ppm/°C: the limit of the rate's change.
    let temperature_cycles =
        |[edge, _]: [&ClockShim; 2]| schedule_temperature_cycles(edge, 4.0, 0.999, 120.0);
    check_case("rate changes by 1 ppm/s, 2/2 ms", [wire_direction(2, 0, 0); 2], 20, temperature_cycles);
}

#[test]
#[ignore = "takes half an hour; for make soak"]
fn intervals_are_right_at_all_rates_on_all_paths() {
    let paths = [("1/1 ms", 1, 1), ("5/40 ms", 5, 40), ("20/20 ms", 20, 20), ("5/300 ms", 5, 300)];
    for (case, up, down) in paths {
        let wire_directions = [wire_direction(up, up / 2, 1), wire_direction(down, down / 4, 1)];
        check_case(case, wire_directions, 420, |[edge, _]| {
            // A cycle passes through every permitted rate of the edge's clock, −199 to 199 ppm.
            schedule_temperature_cycles(edge, 199.0, 0.999, 1_000.0);
        });
    }
}
