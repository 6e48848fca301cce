//! Test of a time daemon that slews the wall clock of a host strongly during a run.

use std::fmt::Write;

use peernet_clock::{ClockFaultStep, ClockFaults, Span, WallTime};
use peernet_tests::truth::{Delay, HostClock, Iteration};
use peernet_tests::{Network, TwoHostTestbed};

use super::{WARM_UP, assert_contains_truth, faults};

/// Period in which a wall clock runs fast: it is set forward repeatedly by a little.
struct Slew {
    at_s: f64,
    duration_s: f64,
    ppm: f64,
}

impl Slew {
    /// Steps per second.
    const STEP_HZ: f64 = 10.0;

    fn steps(&self) -> impl Iterator<Item = ClockFaultStep> {
        let period = Span::from_seconds_f64(1.0 / Self::STEP_HZ);
        let by = Span::from_seconds_f64(self.ppm * 1e-6 / Self::STEP_HZ);
        let (begin, count) = (Span::from_seconds_f64(self.at_s), (self.duration_s * Self::STEP_HZ) as i64);
        (0..count).map(move |number| {
            ClockFaultStep::wall_step(begin + Span::from_nanos(period.nanos() * number), by)
        })
    }
}

/// Returns a clock with an offset that is slewed. [`clock_of`] replaces the beginning of the fault.
fn slewed_clock(offset_ms: i64, slews: &[Slew]) -> ClockFaults {
    let steps = slews.iter().flat_map(Slew::steps).collect();
    ClockFaults { offset: Span::from_millis(offset_ms), drift_ppm: 0.0, steps, since: WallTime::default() }
}

/// Returns the fault as a table of a configuration.
fn table(description: &ClockFaults) -> String {
    let millis = |span: Span| span.nanos() as f64 * 1e-6;
    let steps = description.steps.iter().fold(String::new(), |mut steps, step| {
        let (at_s, by_ms) = (step.at.seconds(), millis(step.by));
        write!(steps, "{{ at_s = {at_s:?}, by_ms = {by_ms:?} }}, ").expect("a string takes any text");
        steps
    });
    faults(millis(description.offset), 0.0, &format!("steps = [{steps}]"))
}

/// Returns the clocks of a running host with all steps of `description`, because the API lists only the first steps.
fn clock_of(testbed: &TwoHostTestbed, host: &str, description: ClockFaults) -> HostClock {
    let reported = testbed.clock_of(host);
    let (since, raw_since) = reported.since().zip(reported.raw_since()).expect("it has faults");
    HostClock::new(ClockFaults { since, ..description }, raw_since)
}

/// A kernel slews at up to 500 ppm by itself; 40,000 ppm are below chrony's default maximum.
#[test]
fn slewed_wall_clock_affects_no_delay() {
    let edge_slews = [
        Slew { at_s: 4.0, duration_s: 4.0, ppm: 500.0 },
        Slew { at_s: 10.0, duration_s: 1.0, ppm: 40_000.0 },
    ];
    let cloud_slews = [Slew { at_s: 6.0, duration_s: 6.0, ppm: 500.0 }];
    let (edge, cloud) = (slewed_clock(-250, &edge_slews), slewed_clock(250, &cloud_slews));
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let _cloud = testbed.start_cloud(&table(&cloud));
    let load = "load = { mode = \"rate\", hz = 100.0 }\nlimit = { duration_s = 16.0 }";
    let pipeline = testbed.pipeline("slewed", 1000, load);
    let _edge = testbed.start_edge(&format!("{}{pipeline}", table(&edge)), &[]);
    let (edge, cloud) = (clock_of(&testbed, "edge", edge), clock_of(&testbed, "cloud", cloud));
    testbed.wait_for_runs(1);

    let iterations = testbed.iterations();
    let (up, down) = assert_contains_truth("500 and 40,000 ppm", &iterations, &edge, &cloud);
    for comparison in [&up, &down] {
        assert!(comparison.without_value.is_empty(), "{:?}", comparison.without_value);
        assert!(comparison.mean_error() < Span::from_micros(50), "{}", comparison.summary());
    }
    let is_good = |delay: &Delay| ["ok", "limited"].contains(&delay.verdict.as_str());
    let settled: Vec<&Iteration> = iterations.iter().filter(|iteration| iteration.number > WARM_UP).collect();
    assert!(settled.len() >= 1_000, "{}", settled.len());
    for iteration in settled {
        assert!(is_good(&iteration.up) && is_good(&iteration.down), "{iteration:?}");
    }
    // The stored wall-clock stamps did move: by 42 ms on the edge and 3 ms on the cloud.
    let stamp_difference = |iteration: &Iteration| iteration.up.received - iteration.up.sent;
    let (first, last) =
        (stamp_difference(&iterations[0]), stamp_difference(&iterations[iterations.len() - 1]));
    assert!((first - last).abs() > Span::from_millis(30), "{first} {last}");
}
