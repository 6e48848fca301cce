//! Tests with clocks that drift beyond the limit, change their rate abruptly, or jump.

use std::path::Path;

use peernet_clock::Span;
use peernet_tests::network::{Network, WireProperties};

use super::{CONSTANT_DRIFT, ClockTestbed, Outcome, WINDOW, direct_network, wire_direction, wire_network};

/// Runs a case whose clocks drift apart faster than the limit from the start on, on a path whose round trip hides
/// the drift.
fn run_with_hidden_drift(
    case: &'static str,
    [up, down]: [WireProperties; 2],
    limit_ppm: f64,
    drift_ppm: f64,
    duration_s: i64,
) -> Outcome {
    let limit = format!("max_drift_ppm = {limit_ppm:?}");
    let testbed = ClockTestbed::new(case, wire_network(up, down), &limit, |[edge, _]| {
        edge.schedule_change(Span::ZERO, drift_ppm, CONSTANT_DRIFT);
    });
    let settled = testbed.wait_for_full_window();
    testbed.wait_until_stored_to(settled + Span::from_seconds(duration_s));
    let outcome = testbed.end();
    outcome.assert_never_wrong();
    outcome
}

/// Within a window of 10 s the clocks drift apart by 7.5 ms. The limit of 200 ppm explains 2 ms of
/// it. The relation tolerates an unexplained movement of a fiftieth of the round trip, which is
/// 0.24 ms here, so the drift repeatedly looks like a jump.
#[test]
fn intervals_are_right_with_hidden_drift() {
    let outcome = run_with_hidden_drift(
        "drift of 750 ppm, limit 200, 6/6 ms",
        [wire_direction(6, 0, 0); 2],
        200.0,
        750.0,
        30,
    );
    outcome.assert_incidents_contain("either the path between them changed, or a clock jumped");
}

#[test]
#[ignore = "takes a quarter of an hour; for make soak"]
fn drift_of_100_ppm_is_proven_despite_delays() {
    let wire_directions = [wire_direction(5, 0, 0), wire_direction(40, 0, 0)];
    // On this path the exchanges prove the excess of 50 ppm only after a quarter of an hour.
    let outcome =
        run_with_hidden_drift("drift of 100 ppm, limit 50, 5/40 ms", wire_directions, 50.0, 100.0, 1_100);
    outcome.assert_no_good_delay_at_end();
    outcome.assert_incidents_contain("max_drift_ppm");
}

/// Runs a case in which the edge's clocks change once during the run.
fn run_with_change(
    case: &'static str,
    network: impl FnOnce(&Path) -> Network,
    (step_ms, ppm): (i64, f64),
    duration_s: i64,
) -> Outcome {
    let testbed = ClockTestbed::new(case, network, "", |_| ());
    testbed.wait_for_full_window();
    let begin = testbed.shim().schedule_change(Span::from_millis(step_ms), ppm, CONSTANT_DRIFT);
    testbed.wait_until_stored_to(begin + Span::from_seconds(duration_s));
    let outcome = testbed.end();
    outcome.assert_wrong_for_at_most(WINDOW, begin);
    outcome
}

#[test]
fn drift_beyond_limit_invalidates_all_delays() {
    let outcome =
        run_with_change("drift of 1,000 ppm begins, limit 200, a cable", direct_network, (0, 1_000.0), 15);
    outcome.assert_no_good_delay_at_end();
    outcome.assert_incidents_contain("max_drift");
}

#[test]
fn sudden_rate_change_affects_one_window_at_most() {
    run_with_change("rate changes by 150 ppm, a cable", direct_network, (0, 150.0), 15).assert_good_at_end();
}

#[test]
fn jittered_rate_change_affects_one_window_at_most() {
    let path = wire_network(wire_direction(2, 2, 1), wire_direction(2, 2, 1));
    run_with_change("rate changes by 180 ppm, 2/2 ms, 2 ms of jitter", path, (0, 180.0), 15)
        .assert_good_at_end();
}

#[test]
fn step_of_all_clocks_affects_one_window_at_most() {
    let path = wire_network(wire_direction(20, 2, 1), wire_direction(20, 2, 1));
    run_with_change("39 ms gained, 20/20 ms, 2 ms of jitter, 1 % lost", path, (39, 0.0), 15)
        .assert_good_at_end();
}

/// If exchanges did not expire, those on the short path would narrow the intervals on the longer path for ever.
#[test]
fn expired_exchange_bounds_no_delay() {
    let case = "1/1 ms becomes 40/40 ms while a drift of 1,000 ppm begins, limit 200";
    let testbed =
        ClockTestbed::new(case, wire_network(wire_direction(1, 0, 0), wire_direction(1, 0, 0)), "", |_| ());
    testbed.wait_for_full_window();
    testbed.hosts.network.set_delays(wire_direction(40, 0, 0), wire_direction(40, 0, 0));
    let begin = testbed.shim().schedule_change(Span::ZERO, 1_000.0, CONSTANT_DRIFT);
    testbed.wait_until_stored_to(begin + WINDOW + Span::from_seconds(8));
    let outcome = testbed.end();
    outcome.assert_wrong_for_at_most(WINDOW, begin);
    // The longer round trip hides the drift, so the delays are good although the drift exceeds the limit.
    outcome.assert_good_at_end();
}
