//! Tests with two hosts and two clocks: the intervals of delays.
//!
//! The agents share this machine's clock under different names. The tests therefore know the true delay: the raw
//! difference, minus the injected error of a clock. The estimator does not know that the clocks are one.

mod bounds;
mod forged;
mod instances;
mod links;
mod probes;
mod reflectors;
mod steps;

use peernet_clock::{ClockFaults, OneWayDelay, Span, WallTime};
use peernet_logger::Measure;
use peernet_stream::Iteration;

use crate::harness::TestAgent;

const CLOUD: &str = "[serve]\nlisten = 'tcp://127.0.0.1:0'\n[[model]]\nname = 'echo'\nkind = 'echo'\n";
/// Number of the first iterations of a run whose delays may have the verdict `Stale`, because the link has had too few
/// exchanges. These delays have bounds, too.
const MAX_STALE_AT_START: u64 = 5;
const DELAY_NAMES: [&str; 2] = ["upload", "download"];

/// Returns a pipeline that uses the model `echo` of a cloud.
fn pipeline(name: &str, cloud: &TestAgent, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = '{name}'\nsensor = {{ kind = 'synthetic', size_bytes = 20000 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'echo' }}\n\
         warm_up = {{ iterations = 0 }}\n{keys}\n",
        cloud.address()
    )
}

/// Returns the judged delay in one direction.
fn delay(iteration: &Iteration, name: &str) -> OneWayDelay {
    transit(iteration, name).2
}

/// Returns the stamps of a message in one direction, and its judged delay.
fn transit(iteration: &Iteration, name: &str) -> (WallTime, WallTime, OneWayDelay) {
    let (_, node) = iteration.tree.find(&[name]).unwrap_or_else(|| panic!("{name} in {:?}", iteration.tree));
    match &node.measure {
        Measure::Transit(transit) => {
            let received = transit.received.expect("arrived");
            (transit.sent, received, transit.delay.expect("judged"))
        }
        other => panic!("{other:?}"),
    }
}

/// Returns the faults of a clock that has this offset and drift from now on.
fn faults_from_now_on(offset: Span, drift_ppm: f64) -> ClockFaults {
    ClockFaults { offset, drift_ppm, steps: Vec::new(), since: crate::harness::clock("now").wall() }
}

/// Returns the true time at which a wrong clock showed `shown`, to about a nanosecond.
fn truth(faults: &ClockFaults, shown: WallTime) -> WallTime {
    // The error changes little within the time of the error itself: three rounds are enough.
    (0..3).fold(shown, |truth, _| shown - faults.wall_error_at(truth))
}

/// Tolerance of [`assert_interval_contains`]: delays are judged by stamps of the free-running clocks, while the truth
/// is computed from stamps of the wall clocks. A wall clock is read at most this much later than the free-running
/// clock.
const TOLERANCE: Span = Span::from_micros(3);

/// Asserts that a delay has a value, and that its interval contains the truth.
#[track_caller]
fn assert_interval_contains(delay: &OneWayDelay, truth: Span) {
    let (Some(value), Some(bounds)) = (delay.value, delay.bounds) else { panic!("{delay:?}") };
    assert!(bounds.lo <= value && value <= bounds.hi, "{delay:?}");
    assert!(!bounds.lo.is_negative(), "{delay:?}");
    let is_within = bounds.lo - TOLERANCE <= truth && truth <= bounds.hi + TOLERANCE;
    assert!(is_within, "{truth} is not within {delay:?}");
}
