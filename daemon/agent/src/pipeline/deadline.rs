//! Records whether an iteration missed its deadline.

use peernet_analysis::deadline::DEADLINE_MISSED;
use peernet_clock::Span;
use peernet_logger::{Measure, Name, NodeId, Tree, Unit, stage};
use peernet_stream::Outcome;

/// Adds the value `deadline-missed`, 0 or 1, to a closed tree. A failed iteration misses every deadline.
pub(super) fn record_deadline(tree: &mut Tree, outcome: &Outcome, deadline: Span) {
    let total = tree.find(&[stage::TOTAL.as_str()]).and_then(|(_, node)| node.measure.value());
    let is_in_time = *outcome == Outcome::Ok && total.is_some_and(|total| total <= deadline.seconds());
    let missed = if is_in_time { 0.0 } else { 1.0 };
    let end = total.map_or(Span::ZERO, Span::from_seconds_f64);
    let measure = Measure::Value(missed, Unit::NONE);
    tree.add(NodeId::ROOT, Name::from_static(DEADLINE_MISSED), end, measure);
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::{HostId, Recorder};

    use super::*;

    fn missed(millis: i64, outcome: &Outcome) -> Option<f64> {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut tree = Recorder::new(Arc::new(clock), HostId::random()).finish();
        let total = Measure::Timer(Some(Span::from_millis(millis)));
        tree.add(NodeId::ROOT, stage::TOTAL, Span::ZERO, total);
        record_deadline(&mut tree, outcome, Span::from_millis(100));
        tree.find(&["deadline-missed"]).and_then(|(_, node)| node.measure.value())
    }

    #[test]
    fn late_and_failed_iterations_miss_their_deadline() {
        assert_eq!(missed(100, &Outcome::Ok), Some(0.0));
        assert_eq!(missed(101, &Outcome::Ok), Some(1.0));
        assert_eq!(missed(20, &Outcome::Lost("cable".to_owned())), Some(1.0));
        assert_eq!(missed(20, &Outcome::Failed("no picture".to_owned())), Some(1.0));
        assert_eq!(missed(100, &Outcome::Timeout(String::new())), Some(1.0));
    }
}
