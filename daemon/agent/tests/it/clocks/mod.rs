//! Two hosts, two clocks: what is known of every delay.
//!
//! The agents share this machine's clock under different names, so that the truth is known and the estimator cannot
//! tell: the raw difference, less what a rehearsal adds, is the delay.

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
/// So many exchanges at the beginning of a link are too few to trust, though bounded.
const FIRST: u64 = 5;
const WAYS: [&str; 2] = ["upload", "download"];

/// A pipeline to the model `echo` of a cloud.
fn line(name: &str, cloud: &TestAgent, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = '{name}'\nsensor = {{ kind = 'synthetic', size_bytes = 20000 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'echo' }}\n\
         warm_up = {{ iterations = 0 }}\n{keys}\n",
        cloud.address()
    )
}

/// What was said of a message's way.
fn delay(iteration: &Iteration, way: &str) -> OneWayDelay {
    transit(iteration, way).2
}

/// The stamps of a message's way, and what was said of it.
fn transit(iteration: &Iteration, way: &str) -> (WallTime, WallTime, OneWayDelay) {
    let (_, node) = iteration.tree.find(&[way]).unwrap_or_else(|| panic!("{way} in {:?}", iteration.tree));
    match &node.measure {
        Measure::Transit(transit) => {
            let received = transit.received.expect("arrived");
            (transit.sent, received, transit.delay.expect("judged"))
        }
        other => panic!("{other:?}"),
    }
}

/// A clock that is wrong from now on.
fn wrong(offset: Span, drift_ppm: f64) -> ClockFaults {
    ClockFaults { offset, drift_ppm, steps: Vec::new(), since: crate::harness::clock("now").wall() }
}

/// When a clock that is wrong showed `shown`, to a nanosecond or so.
fn truth(wrong: &ClockFaults, shown: WallTime) -> WallTime {
    // The error changes little over the error itself: three rounds are plenty.
    (0..3).fold(shown, |truth, _| shown - wrong.error_at(truth))
}

/// Delays are judged by stamps of the free-running clocks, and the truth is known by those of the wall clocks, which are read at
/// most so much later.
const APART: Span = Span::from_micros(3);

/// Asserts that a delay has a value, and that its interval holds the truth.
#[track_caller]
fn assert_holds(delay: &OneWayDelay, truth: Span) {
    let (Some(value), Some(bounds)) = (delay.value, delay.bounds) else { panic!("{delay:?}") };
    assert!(bounds.lo <= value && value <= bounds.hi, "{delay:?}");
    assert!(!bounds.lo.is_negative(), "{delay:?}");
    let holds = bounds.lo - APART <= truth && truth <= bounds.hi + APART;
    assert!(holds, "{truth} is not within {delay:?}");
}
