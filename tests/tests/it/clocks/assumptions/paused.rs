//! Tests with hosts that pause: only the process, a whole virtual machine, or a cloud that is restarted.

use peernet_clock::{RawTime, Span};
use rustix::process::Signal;

use super::{CONSTANT_DRIFT, ClockTestbed, Outcome, Process, WINDOW, wire_direction, wire_network};

/// Drift of the edge's clocks before and after a pause.
const DRIFT_PPM: f64 = 150.0;

/// Stops a process for a while and calls `during_pause` meanwhile. Returns the result, and the times at which the process was
/// stopped and resumed.
fn pause_process(
    case: &'static str,
    length: Span,
    process_of: fn(&ClockTestbed) -> &Process,
    during_pause: impl FnOnce(&ClockTestbed),
) -> (Outcome, RawTime, RawTime) {
    let testbed = ClockTestbed::new(
        case,
        wire_network(wire_direction(2, 0, 0), wire_direction(2, 0, 0)),
        "",
        |[edge, _]| {
            edge.schedule_change(Span::from_seconds(77), DRIFT_PPM, CONSTANT_DRIFT);
        },
    );
    testbed.wait_for_full_window();
    process_of(&testbed).signal(Signal::STOP);
    let stopped = testbed.shim().now();
    during_pause(&testbed);
    // No event ends the pause, so the test sleeps.
    std::thread::sleep((stopped + length - testbed.shim().now()).to_duration());
    let resumed = testbed.shim().now();
    process_of(&testbed).signal(Signal::CONT);
    testbed.wait_until_stored_to(resumed + WINDOW + Span::from_seconds(5));
    (testbed.end(), stopped, resumed)
}

const fn edge(testbed: &ClockTestbed) -> &Process {
    &testbed.edge
}

/// Stops only the process; its clocks keep running.
fn check_stopped_process(case: &'static str, length: Span, process_of: fn(&ClockTestbed) -> &Process) {
    let (outcome, ..) = pause_process(case, length, process_of, |_| ());
    outcome.assert_never_wrong();
    outcome.assert_good_at_end();
}

/// Stops the process, and sets its clocks back by the length of the pause while it is stopped: the clocks of a paused
/// virtual machine do not advance.
fn check_paused_machine(case: &'static str, length: Span) {
    let (outcome, stopped, resumed) = pause_process(case, length, edge, |testbed| {
        testbed.shim().schedule_change(-length, DRIFT_PPM, CONSTANT_DRIFT);
    });
    outcome.assert_wrong_for_at_most(WINDOW + (resumed - stopped), stopped);
    outcome.assert_good_at_end();
}

#[test]
fn intervals_are_right_after_process_stop() {
    check_stopped_process("the edge is stopped for 2 s, 2/2 ms", Span::from_seconds(2), edge);
}

#[test]
fn intervals_are_right_after_cloud_process_stop() {
    check_stopped_process("the cloud is stopped for 2 s, 2/2 ms", Span::from_seconds(2), ClockTestbed::cloud);
}

#[test]
#[ignore = "takes eleven minutes; for make soak"]
fn intervals_are_right_after_ten_minute_stop() {
    check_stopped_process("the edge is stopped for 600 s, 2/2 ms", Span::from_seconds(600), edge);
}

#[test]
fn paused_vm_affects_one_window_at_most() {
    check_paused_machine("a virtual machine is paused for 0.5 s, 2/2 ms", Span::from_millis(500));
}

#[test]
#[ignore = "takes eleven minutes; for make soak"]
fn long_vm_pause_affects_one_window_at_most() {
    check_paused_machine("a virtual machine is paused for 600 s, 2/2 ms", Span::from_seconds(600));
}

#[test]
fn intervals_are_right_after_cloud_reboot() {
    let case = "the cloud is rebooted, 2/6 ms";
    let mut testbed = ClockTestbed::new(
        case,
        wire_network(wire_direction(2, 0, 0), wire_direction(6, 0, 0)),
        "",
        |[edge, cloud]| {
            edge.schedule_change(Span::from_seconds(3), -50.0, CONSTANT_DRIFT);
            cloud.schedule_change(Span::from_seconds(7_200), 100.0, CONSTANT_DRIFT);
        },
    );
    testbed.wait_for_full_window();
    testbed.reboot_cloud(Span::from_seconds(-7_000), -100.0);
    let rebooted = testbed.shim().now();
    testbed.wait_until_stored_to(rebooted + Span::from_seconds(8));
    let outcome = testbed.end();
    outcome.assert_never_wrong();
    outcome.assert_good_at_end();
}
