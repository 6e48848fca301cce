//! The tree of one iteration.
//!
//! Its root starts at the intended start, so that a stall of the edge shows in the latency.

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::{HostId, Measure, NodeId, Recorder, Tree, Unit, stage};

use super::in_flight::StartedIteration;

/// Starts the tree of an iteration with its root at `intended`. Also returns the actual start.
pub(super) fn start(clock: &SharedClock, host: HostId, intended: MonoTime) -> (Recorder, MonoTime) {
    let now = clock.stamp();
    // All clocks of the stamp are moved back by the lateness, so that the wall clock also shows the intended start.
    let at = now - (now.mono - intended);
    (Recorder::starting_at(SharedClock::clone(clock), host, at), now.mono)
}

/// Closes the tree of an iteration that ended at `ended`, and adds the totals. Every tree reserves nodes for the
/// totals, so that they fit even if a sensor or a model has filled the tree. `transport` is the sum of upload and
/// download, if it is known.
pub(super) fn close(
    log: Recorder,
    iteration: &StartedIteration,
    ended: MonoTime,
    closed_loop: bool,
    transport: Option<Span>,
) -> Tree {
    let total = ended - iteration.start.intended;
    // A transport that is longer than the whole iteration is an error of measurement and is not used.
    let stages = stages_total(log.tree(), transport.filter(|transport| *transport <= total));
    add_totals(log, iteration, ended, closed_loop, stages)
}

/// Closes a tree as [`close`] does, but without the sum of the stages, for an iteration of a closed loop whose stages
/// are not all measured.
pub(super) fn close_without_stages(log: Recorder, iteration: &StartedIteration, ended: MonoTime) -> Tree {
    let (closed_loop, stages) = (true, None);
    add_totals(log, iteration, ended, closed_loop, stages)
}

/// Closes a tree and adds skipped starts, lateness and totals. `stages` is the sum of the stages, if it is known.
fn add_totals(
    log: Recorder,
    iteration: &StartedIteration,
    ended: MonoTime,
    closed_loop: bool,
    stages: Option<Span>,
) -> Tree {
    let intended = iteration.start.intended;
    let total = ended - intended;
    let mut tree = log.finish();
    if iteration.start.skipped > 0 {
        let skipped = Measure::Value(iteration.start.skipped as f64, Unit::NONE);
        tree.add(NodeId::ROOT, stage::SKIPPED_STARTS, total, skipped);
    }
    let mut add = |name, start, span| tree.add(NodeId::ROOT, name, start, Measure::Timer(Some(span)));
    // The lateness shows whether the pipeline keeps up with its rate. A closed loop is never late.
    if !closed_loop {
        add(stage::LATENESS, Span::ZERO, iteration.started_at - intended);
    }
    add(stage::TOTAL, Span::ZERO, total);
    if let Some(stages) = stages {
        add(stage::STAGES_TOTAL, Span::ZERO, stages);
        add(stage::UNATTRIBUTED, stages, total - stages);
    }
    tree
}

/// Returns the sum of the stages; `None` if the duration of a stage is unknown.
///
/// Upload and download have no values if the two clocks are not related, or if one of them was stepped. `transport`
/// then replaces their sum: it is the edge's waiting time minus the time on the cloud. The edge's clock measures the
/// former, and the cloud's clock the latter, so the offset of the clocks has no effect.
fn stages_total(tree: &Tree, transport: Option<Span>) -> Option<Span> {
    let mut sum = Span::ZERO;
    let mut transit_sum = Some(Span::ZERO);
    // Only children of the root are summed up. A deeper node with the name of a stage, such as the node of a model that
    // another model calls, is already part of a stage.
    for (_, node) in tree.children(NodeId::ROOT).filter(|(_, node)| stage::ORDER.contains(&node.name)) {
        match &node.measure {
            Measure::Timer(Some(span)) => sum += *span,
            Measure::Transit(transit) => {
                if let Some(delay) = transit.delay {
                    transit_sum = transit_sum
                        .zip(delay.value)
                        .map(|(transit_sum, delay_value)| transit_sum + delay_value);
                }
            }
            _ => {}
        }
    }
    Some(sum + transit_sum.or(transport)?)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{Clock, ClockIdentity, Direction, ManualClock, OneWayDelay, Stamp, WallTime};

    use super::super::load::Start;
    use super::super::progress::Position;
    use super::*;
    use crate::link::correct;

    const MILLISECOND: Span = Span::from_millis(1);

    /// Returns the tree of an iteration that began 3 ms late, sensed for 1 ms, took 1 ms each for upload, download and
    /// actuation and 2 ms on a cloud; 1 ms passed after the download, outside of all stages. The cloud's wall clock is
    /// ahead of the edge's by `cloud_offset`.
    fn iteration(cloud_offset: Span, judge: fn(Span) -> OneWayDelay, transport: Option<Span>) -> Tree {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let pass = |millis: i64| clock.advance(Span::from_millis(millis));
        let intended = clock.mono();
        pass(3);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let (mut log, started_at) = start(&shared, HostId::random(), intended);
        {
            let _sensing = log.time(stage::SENSING);
            pass(1);
        }
        let up = log.start_transit(stage::UPLOAD, clock.stamp());
        pass(1);
        log.end_transit(up, clock.wall() + cloud_offset);
        {
            let _inference = log.time(stage::INFERENCE);
            pass(2);
        }
        let sent = Stamp { wall: clock.wall() + cloud_offset, ..clock.stamp() };
        let down = log.start_transit(stage::DOWNLOAD, sent);
        pass(1);
        log.end_transit(down, clock.wall());
        correct(log.tree_mut(), up, Direction::Up, judge(MILLISECOND + cloud_offset));
        correct(log.tree_mut(), down, Direction::Down, judge(MILLISECOND - cloud_offset));
        pass(1);
        {
            let _actuation = log.time(stage::ACTUATION);
            pass(1);
        }
        let position = Position { number: 1, episode: 0, step: 0, warm_up: false };
        let iteration = StartedIteration { position, start: Start { intended, skipped: 7 }, started_at };
        let closed_loop = false;
        close(log, &iteration, clock.mono(), closed_loop, transport)
    }

    fn millis(tree: &Tree, name: &str) -> Option<f64> {
        Some((tree.find(&[name])?.1.measure.value()? * 1e3).round())
    }

    #[test]
    fn stages_and_unattributed_time_add_up_to_total() {
        let tree = iteration(Span::ZERO, OneWayDelay::same_clock, None);
        assert_eq!(millis(&tree, "total"), Some(10.0));
        assert_eq!(millis(&tree, "stages-total"), Some(6.0));
        assert_eq!(millis(&tree, "unattributed"), Some(4.0));
        assert_eq!(millis(&tree, "lateness"), Some(3.0));
        assert_eq!(tree.find(&["skipped-starts"]).and_then(|(_, node)| node.measure.value()), Some(7.0));
    }

    #[test]
    fn full_tree_still_gets_its_totals() {
        let clock: SharedClock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let intended = clock.mono();
        let (mut log, started_at) = start(&clock, HostId::random(), intended);
        while log.record_value("chatter".into(), 1.0, Unit::NONE) != NodeId::SKIPPED {}
        let position = Position { number: 1, episode: 0, step: 0, warm_up: false };
        let iteration = StartedIteration { position, start: Start { intended, skipped: 7 }, started_at };
        let (closed_loop, transport) = (false, None);
        let tree = close(log, &iteration, intended + MILLISECOND, closed_loop, transport);
        for (name, expected) in [("total", 1.0), ("unattributed", 1.0), ("lateness", 0.0)] {
            assert_eq!(millis(&tree, name), Some(expected), "{name}");
        }
        assert!(tree.find(&["skipped-starts"]).is_some() && tree.find(&["skipped-nodes"]).is_some());
    }

    #[test]
    fn stages_total_is_independent_of_peers_clock() {
        for cloud_offset in [Span::from_seconds(3600), Span::from_seconds(-5)] {
            let tree = iteration(cloud_offset, OneWayDelay::unsynchronised, Some(MILLISECOND + MILLISECOND));
            assert_eq!(millis(&tree, "upload"), None, "the clocks are not related");
            assert_eq!(millis(&tree, "stages-total"), Some(6.0));
        }
    }

    #[test]
    fn stages_total_is_unknown_if_one_direction_is_unknown() {
        // The delay of the upload is unknown, because it would be negative. A transport of an hour is not used, because
        // it is longer than the iteration.
        for transport in [None, Some(Span::from_seconds(3600))] {
            let tree = iteration(Span::from_seconds(-1), OneWayDelay::same_clock, transport);
            assert_eq!((millis(&tree, "total"), millis(&tree, "stages-total")), (Some(10.0), None));
        }
    }
}
