//! One-way delays and throughputs of an iteration that went to another host and back.

use peernet_clock::{Direction, OneWayDelay, Relation};
use peernet_logger::{Measure, Name, NodeId, Rate, Tree, stage};

/// Corrects the two nodes that cross hosts by what is known of the hosts' clocks, and adds the throughputs.
///
/// This is where the four stamps of every exchange come together (the start and the end of `upload`, the start
/// and the end of `download`): the estimator of the clock band is to be fed here, before the delays are judged.
pub(crate) fn correct(tree: &mut Tree, relation: &Relation, up: Option<NodeId>, down: Option<NodeId>) {
    const UP: [Name; 3] = [stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES, stage::UPLOAD_THROUGHPUT];
    const DOWN: [Name; 3] = [stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES, stage::DOWNLOAD_THROUGHPUT];
    for (transit, direction, names) in [(up, Direction::Up, UP), (down, Direction::Down, DOWN)] {
        let Some(transit) = transit else { continue };
        let Some(delay) = judge(tree, relation, transit, direction) else { continue };
        let [payload, metadata, throughput] = names;
        let bytes: f64 = [payload, metadata].iter().filter_map(|name| value(tree, name)).sum();
        let start = tree.get(transit).map(|node| node.start).unwrap_or_default();
        if bytes > 0.0 {
            tree.add(NodeId::ROOT, throughput, start, Measure::Throughput(rate(8.0 * bytes, &delay)));
        }
    }
}

/// Sets the delay of a transit that has arrived.
fn judge(tree: &mut Tree, relation: &Relation, transit: NodeId, direction: Direction) -> Option<OneWayDelay> {
    let Some(Measure::Transit(transit)) = tree.measure_mut(transit) else { return None };
    let delay = relation.delay(direction, transit.sent, transit.received?);
    transit.delay = Some(delay);
    Some(delay)
}

fn value(tree: &Tree, name: &Name) -> Option<f64> {
    tree.nodes().iter().find(|node| node.name == *name)?.measure.value()
}

/// Bits over a delay, with the bounds that follow from the delay's.
fn rate(bits: f64, delay: &OneWayDelay) -> Rate {
    // A delay of zero, which a coarse clock can show, gives no rate; a lower bound of zero an infinite one.
    let over = |seconds: f64| if seconds > 0.0 { bits / seconds } else { f64::INFINITY };
    Rate {
        value: delay.value.map(|delay| over(delay.seconds())).filter(|rate| rate.is_finite()),
        bounds: delay.bounds.map(|bounds| (over(bounds.hi.seconds()), over(bounds.lo.seconds()))),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{Clock, ClockIdentity, Interval, ManualClock, Span, Verdict, WallTime};
    use peernet_logger::{HostId, Recorder, Unit};

    use super::*;

    /// 1,000 bytes up in 2 ms, nothing known of their number down.
    fn exchange() -> (Tree, NodeId, NodeId) {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let mut log = Recorder::begin(Arc::<ManualClock>::clone(&clock), HostId::random());
        let up = log.depart(stage::UPLOAD, clock.stamp());
        log.value(stage::UPLOAD_BYTES, 900.0, Unit::BYTES);
        log.value(stage::UPLOAD_LOGGER_BYTES, 100.0, Unit::BYTES);
        clock.advance(Span::from_millis(2));
        log.arrive(up, clock.wall());
        let down = log.depart(stage::DOWNLOAD, clock.stamp());
        clock.advance(Span::from_millis(1));
        log.arrive(down, clock.wall());
        (log.finish(), up, down)
    }

    #[test]
    fn one_clock_gives_exact_delays_and_throughputs() {
        let (mut tree, up, down) = exchange();
        correct(&mut tree, &Relation::SameClock, Some(up), Some(down));
        let found = |name| tree.find(&[name]).map(|(_, node)| &node.measure);
        assert_eq!(found("upload").and_then(Measure::value), Some(0.002));
        assert_eq!(found("download").and_then(Measure::value), Some(0.001));
        let Some(Measure::Throughput(rate)) = found("upload-throughput") else { panic!("{tree:?}") };
        assert_eq!((rate.value, rate.bounds), (Some(4e6), Some((4e6, 4e6))));
        assert_eq!(found("download-throughput"), None, "no size, no throughput");
    }

    #[test]
    fn unrelated_clocks_give_the_raw_difference_and_a_throughput_without_value() {
        let (mut tree, up, down) = exchange();
        correct(&mut tree, &Relation::Unknown, Some(up), Some(down));
        let Some((_, node)) = tree.find(&["upload"]) else { panic!("{tree:?}") };
        let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
        let delay = transit.delay.expect("judged");
        assert_eq!(
            (delay.raw, delay.value, delay.verdict),
            (Span::from_millis(2), None, Verdict::Unsynchronised)
        );
        let throughput = tree.find(&["upload-throughput"]).expect("there").1;
        assert_eq!(throughput.measure, Measure::Throughput(Rate { value: None, bounds: None }));
    }

    #[test]
    fn a_message_that_never_arrived_is_left_open() {
        let (mut tree, up, _) = exchange();
        correct(&mut tree, &Relation::SameClock, Some(up), None);
        assert!(tree.find(&["upload-throughput"]).is_some() && tree.find(&["download-throughput"]).is_none());
    }

    #[test]
    fn a_bound_that_reaches_zero_leaves_the_rate_open_upwards() {
        let delay = OneWayDelay {
            bounds: Some(Interval { lo: Span::ZERO, hi: Span::from_millis(4) }),
            ..OneWayDelay::same_clock(Span::from_millis(2))
        };
        assert_eq!(rate(8000.0, &delay).bounds, Some((2e6, f64::INFINITY)));
        assert_eq!(rate(8000.0, &OneWayDelay::same_clock(Span::ZERO)).value, None);
    }
}
