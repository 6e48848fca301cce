//! The tree of one iteration, from its intended start to its end.

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::{HostId, Measure, Name, NodeId, Recorder, Tree, Unit, stage};

use super::in_flight::PendingIteration;

/// Starts that were skipped between this iteration and the one before it, because the pipeline was too far
/// behind its rate. Absent when there were none.
const SKIPPED_STARTS: Name = Name::from_static("skipped-starts");
/// From the intended start to the real one. Part of `unattributed`, named because it says that the pipeline
/// did not keep up. Absent in a closed loop, which is never late.
const LATENESS: Name = Name::from_static("lateness");

/// Begins the tree of an iteration that was meant to begin at `intended`: its root begins then. Returns when
/// it really began, too.
pub(super) fn begin(clock: &SharedClock, host: HostId, intended: MonoTime) -> (Recorder, MonoTime) {
    let now = clock.stamp();
    let at = now - (now.mono - intended);
    (Recorder::begin_at(SharedClock::clone(clock), host, at), now.mono)
}

/// Closes the tree of an iteration that ended at `ended`: adds what is computed over the whole, for which even a tree
/// that a sensor or a model filled has room. `transport` is the time of both ways together, where it is known.
pub(super) fn close(
    log: Recorder,
    pending: &PendingIteration,
    ended: MonoTime,
    closed_loop: bool,
    transport: Option<Span>,
) -> Tree {
    let total = ended - pending.start.intended;
    let stages = stages_total(log.tree(), transport.filter(|transport| *transport <= total));
    finish(log, pending, ended, closed_loop, stages)
}

/// As [`close`] for an iteration of a closed loop that had stages of which too little is known.
pub(super) fn close_without_stages(log: Recorder, pending: &PendingIteration, ended: MonoTime) -> Tree {
    finish(log, pending, ended, true, None)
}

fn finish(
    log: Recorder,
    pending: &PendingIteration,
    ended: MonoTime,
    closed_loop: bool,
    stages: Option<Span>,
) -> Tree {
    let intended = pending.start.intended;
    let total = ended - intended;
    let mut tree = log.finish();
    if pending.start.skipped > 0 {
        let skipped = Measure::Value(pending.start.skipped as f64, Unit::NONE);
        tree.add(NodeId::ROOT, SKIPPED_STARTS, total, skipped);
    }
    let mut add = |name, start, span| tree.add(NodeId::ROOT, name, start, Measure::Timer(Some(span)));
    if !closed_loop {
        add(LATENESS, Span::ZERO, pending.began_at - intended);
    }
    add(stage::TOTAL, Span::ZERO, total);
    if let Some(stages) = stages {
        add(stage::STAGES_TOTAL, Span::ZERO, stages);
        add(stage::UNATTRIBUTED, stages, total - stages);
    }
    tree
}

/// The sum of the stages; `None` when one of them took place and it is not known how long it took.
///
/// Where the two clocks were not related, or one of them was stepped, the way up and the way down have no value each;
/// both together are still known: what the edge waited less what the cloud took.
fn stages_total(tree: &Tree, transport: Option<Span>) -> Option<Span> {
    let mut sum = Span::ZERO;
    let mut ways = Some(Span::ZERO);
    for (_, node) in tree.children(NodeId::ROOT).filter(|(_, node)| stage::ORDER.contains(&node.name)) {
        match &node.measure {
            Measure::Timer(Some(span)) => sum += *span,
            Measure::Transit(transit) => {
                if let Some(delay) = transit.delay {
                    ways = ways.zip(delay.value).map(|(ways, way)| ways + way);
                }
            }
            _ => {}
        }
    }
    Some(sum + ways.or(transport)?)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{Clock, ClockIdentity, Direction, ManualClock, OneWayDelay, Stamp, WallTime};

    use super::super::load::Start;
    use super::super::progress::Position;
    use super::*;
    use crate::link::correct;

    const STEP: Span = Span::from_millis(1);

    /// An iteration that began 3 ms late, sensed for 1 ms, went up, down and was acted upon for 1 ms each, with
    /// 2 ms on a cloud whose wall clock is `ahead`; 1 ms passed outside of all stages.
    fn iteration(ahead: Span, judge: fn(Span) -> OneWayDelay, transport: Option<Span>) -> Tree {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let pass = |steps: i64| clock.advance(Span::from_nanos(STEP.nanos() * steps));
        let intended = clock.mono();
        pass(3);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let (mut log, began_at) = begin(&shared, HostId::random(), intended);
        {
            let _sensing = log.time(stage::SENSING);
            pass(1);
        }
        let up = log.depart(stage::UPLOAD, clock.stamp());
        pass(1);
        log.arrive(up, clock.wall() + ahead);
        {
            let _inference = log.time(stage::INFERENCE);
            pass(2);
        }
        let sent = Stamp { wall: clock.wall() + ahead, ..clock.stamp() };
        let down = log.depart(stage::DOWNLOAD, sent);
        pass(1);
        log.arrive(down, clock.wall());
        correct(log.tree_mut(), up, Direction::Up, judge(STEP + ahead));
        correct(log.tree_mut(), down, Direction::Down, judge(STEP - ahead));
        pass(1);
        {
            let _actuation = log.time(stage::ACTUATION);
            pass(1);
        }
        let position = Position { number: 1, episode: 0, step: 0, warm_up: false };
        let pending = PendingIteration { position, start: Start { intended, skipped: 7 }, began_at };
        close(log, &pending, clock.mono(), false, transport)
    }

    fn millis(tree: &Tree, name: &str) -> Option<f64> {
        Some((tree.find(&[name])?.1.measure.value()? * 1e3).round())
    }

    #[test]
    fn stages_and_what_lies_beside_them_add_up_to_the_total() {
        let tree = iteration(Span::ZERO, OneWayDelay::same_clock, None);
        assert_eq!(millis(&tree, "total"), Some(10.0));
        assert_eq!(millis(&tree, "stages-total"), Some(6.0));
        assert_eq!(millis(&tree, "unattributed"), Some(4.0));
        assert_eq!(millis(&tree, "lateness"), Some(3.0));
        assert_eq!(tree.find(&["skipped-starts"]).and_then(|(_, node)| node.measure.value()), Some(7.0));
    }

    #[test]
    fn a_tree_without_room_for_more_still_gets_its_totals() {
        let clock: SharedClock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let intended = clock.mono();
        let (mut log, began_at) = begin(&clock, HostId::random(), intended);
        while log.value("chatter".into(), 1.0, Unit::NONE) != NodeId::NOWHERE {}
        let position = Position { number: 1, episode: 0, step: 0, warm_up: false };
        let pending = PendingIteration { position, start: Start { intended, skipped: 7 }, began_at };
        let tree = close(log, &pending, intended + STEP, false, None);
        for (name, expected) in [("total", 1.0), ("unattributed", 1.0), ("lateness", 0.0)] {
            assert_eq!(millis(&tree, name), Some(expected), "{name}");
        }
        assert!(tree.find(&["skipped-starts"]).is_some() && tree.find(&["skipped-nodes"]).is_some());
    }

    #[test]
    fn the_sum_does_not_depend_on_what_the_peers_clock_shows() {
        for ahead in [Span::from_seconds(3600), Span::from_seconds(-5)] {
            let tree = iteration(ahead, OneWayDelay::unsynchronised, Some(STEP + STEP));
            assert_eq!(millis(&tree, "upload"), None, "not known");
            assert_eq!(millis(&tree, "stages-total"), Some(6.0));
        }
    }

    #[test]
    fn without_the_time_of_both_ways_there_is_no_sum() {
        // An hour on the way is more than the iteration took.
        for transport in [None, Some(Span::from_seconds(3600))] {
            let tree = iteration(Span::from_seconds(-1), OneWayDelay::same_clock, transport);
            assert_eq!((millis(&tree, "total"), millis(&tree, "stages-total")), (Some(10.0), None));
        }
    }
}
