//! Adds one-way delays and throughputs to the tree of an iteration that another host answered.

use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::{Direction, OneWayDelay};
use peernet_logger::{Measure, Name, NodeId, Rate, Tree};

/// Sets the delay of a transit that has arrived, and adds the throughput that follows from the delay.
pub(crate) fn correct(tree: &mut Tree, transit: NodeId, direction: Direction, delay: OneWayDelay) {
    let Some(Measure::Transit(transit_measure)) = tree.measure_mut(transit) else { return };
    transit_measure.delay = Some(delay);
    let start = tree.get(transit).map(|node| node.start).unwrap_or_default();
    if let Some(bits) = sent_bits(tree, direction) {
        let throughput = DirectionNodes::of(direction).throughput.clone();
        tree.add(NodeId::ROOT, throughput, start, Measure::Throughput(rate(bits, &delay)));
    }
}

/// Returns the number of bits that were sent in a direction, for payload and metadata; `None` if the number is unknown.
pub(super) fn sent_bits(tree: &Tree, direction: Direction) -> Option<f64> {
    let DirectionNodes { payload, metadata, .. } = DirectionNodes::of(direction);
    let bytes: f64 = [payload, metadata].into_iter().filter_map(|name| value_of(tree, name)).sum();
    (bytes > 0.0).then_some(8.0 * bytes)
}

fn value_of(tree: &Tree, name: &Name) -> Option<f64> {
    tree.nodes().iter().find(|node| node.name == *name)?.measure.value()
}

/// Returns the rate of bits over a delay, with the bounds that follow from the delay's bounds.
pub(super) fn rate(bits: f64, delay: &OneWayDelay) -> Rate {
    // A delay of zero, which a coarse clock can show, gives no rate; a lower bound of zero gives an infinite upper
    // bound of the rate.
    let rate_over = |seconds: f64| if seconds > 0.0 { bits / seconds } else { f64::INFINITY };
    Rate {
        value: delay.value.map(|delay| rate_over(delay.seconds())).filter(|rate| rate.is_finite()),
        bounds: delay.bounds.map(|bounds| (rate_over(bounds.hi.seconds()), rate_over(bounds.lo.seconds()))),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{Clock, ClockIdentity, Interval, ManualClock, Span, Verdict, WallTime};
    use peernet_logger::{HostId, Recorder, Unit, stage};

    use super::*;

    const UP: Span = Span::from_millis(2);

    /// Returns a tree in which 1,000 bytes went up in 2 ms, and an unknown number went down.
    fn exchange() -> (Tree, NodeId, NodeId) {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system")));
        let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
        let up = log.start_transit(stage::UPLOAD, clock.stamp());
        log.record_value(stage::UPLOAD_BYTES, 900.0, Unit::BYTES);
        log.record_value(stage::UPLOAD_LOGGER_BYTES, 100.0, Unit::BYTES);
        clock.advance(UP);
        log.end_transit(up, clock.wall());
        let down = log.start_transit(stage::DOWNLOAD, clock.stamp());
        clock.advance(Span::from_millis(1));
        log.end_transit(down, clock.wall());
        (log.finish(), up, down)
    }

    #[test]
    fn one_clock_gives_exact_delays_and_throughputs() {
        let (mut tree, up, down) = exchange();
        correct(&mut tree, up, Direction::Up, OneWayDelay::same_clock(UP));
        correct(&mut tree, down, Direction::Down, OneWayDelay::same_clock(Span::from_millis(1)));
        let measure_of = |name| tree.find(&[name]).map(|(_, node)| &node.measure);
        assert_eq!(measure_of("upload").and_then(Measure::value), Some(0.002));
        assert_eq!(measure_of("download").and_then(Measure::value), Some(0.001));
        let Some(Measure::Throughput(rate)) = measure_of("upload-throughput") else { panic!("{tree:?}") };
        assert_eq!((rate.value, rate.bounds), (Some(4e6), Some((4e6, 4e6))));
        assert_eq!(measure_of("download-throughput"), None, "without a size there is no throughput");
    }

    #[test]
    fn unrelated_clocks_give_raw_difference_and_no_throughput() {
        let (mut tree, up, _) = exchange();
        correct(&mut tree, up, Direction::Up, OneWayDelay::unsynchronised(UP));
        let Some((_, node)) = tree.find(&["upload"]) else { panic!("{tree:?}") };
        let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
        let delay = transit.delay.expect("the delay is judged");
        assert_eq!((delay.raw, delay.value, delay.verdict), (UP, None, Verdict::Unsynchronised));
        let throughput = tree.find(&["upload-throughput"]).expect("there").1;
        assert_eq!(throughput.measure, Measure::Throughput(Rate { value: None, bounds: None }));
    }

    #[test]
    fn bound_of_zero_leaves_rate_unbounded() {
        let delay = OneWayDelay {
            bounds: Some(Interval { lo: Span::ZERO, hi: Span::from_millis(4) }),
            ..OneWayDelay::same_clock(UP)
        };
        assert_eq!(rate(8000.0, &delay).bounds, Some((2e6, f64::INFINITY)));
        assert_eq!(rate(8000.0, &OneWayDelay::same_clock(Span::ZERO)).value, None);
    }
}
