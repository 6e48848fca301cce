//! Speed while sending and traffic of each direction.
//!
//! *Speed while sending* is bytes divided by their transfer time, which requires known delays. *Traffic* is bytes
//! divided by wall time.

use std::sync::Arc;

use peernet_aggregator::{LiveSecond, Window};
use peernet_analysis::delays::{ClockInterval, VerdictCounts};
use peernet_analysis::transfer::{DirectionNodes, KnownSpeed, Transfers, is_speed_interval_only};
use peernet_clock::{Direction, Verdict};
use peernet_statistics::Merge;
use peernet_statistics::number::{NONE, throughput, throughput_between};
use peernet_store::{DelayAccuracy, QuantityStatistics};
use peernet_stream::PlacementKind;

use super::clocks;
use super::pipeline_table::Cell;

const MINUTE_S: i64 = 60;

/// Returns the accuracy of the delays of a direction; `None` without delays.
fn bound_of(bounds: &[DelayAccuracy], direction: Direction) -> Option<&DelayAccuracy> {
    bounds.iter().find(|bound| bound.stage == DirectionNodes::of(direction).delay)
}

/// Returns the speed while sending in a direction if the clocks determine it.
pub(crate) fn known_speed(
    transfers: &Transfers,
    bounds: &[DelayAccuracy],
    direction: Direction,
) -> Option<KnownSpeed> {
    transfers.of(direction)?.known_speed(bound_of(bounds, direction).and_then(clocks::verdict))
}

/// Returns the reason why a chart of `series` has no line for a direction; `None` if the chart has such a line. The
/// reason is that of the minute that ends with the newest successful iteration.
// For a pipeline that has ended, the minute before now would always give the reason that no iteration succeeded. But
// the chart still shows earlier minutes.
pub(crate) fn obstacle_in(series: &[Arc<LiveSecond>], direction: Direction) -> Option<&'static str> {
    let last = series.iter().rfind(|second| second.counts.ok > 0).map(|second| second.at);
    let minute = || series.iter().filter(|second| last.is_some_and(|last| second.at > last - MINUTE_S));
    let mut verdicts = VerdictCounts::default();
    // `verdicts` has the order of `Direction`: up, down.
    minute().for_each(|second| verdicts.merge(&second.verdicts[direction as usize]));
    find_obstacle(Verdict::summarise(verdicts.counts()), minute().map(|second| second.counts.ok).sum())
}

/// Returns the reason why there is no single speed, from the verdict on the delays and the number of successful
/// iterations.
fn find_obstacle(verdict: Option<Verdict>, successful_iterations: u64) -> Option<&'static str> {
    match verdict {
        Some(_) => clock_obstacle(verdict),
        None if successful_iterations == 0 => Some("no successful iteration in this time"),
        None => Some("nothing was sent in this direction"),
    }
}

/// Returns the reason why the verdict on the delays permits no single speed; `None` if it permits one.
pub(crate) const fn clock_obstacle(verdict: Option<Verdict>) -> Option<&'static str> {
    match is_speed_interval_only(verdict) {
        Some(false) => None,
        Some(true) => Some("known only within its clock bound"),
        None => Some("the clocks do not determine this direction's delay"),
    }
}

/// Returns the speed while sending in a direction in MB/s as text: a number, or an interval if the verdict on the
/// delays is `limited`. `None` if the speed or its interval is not known. `delay` has the statistics of the delays.
pub(crate) fn text(
    transfers: &Transfers,
    bounds: &[DelayAccuracy],
    direction: Direction,
    delay: Option<&QuantityStatistics>,
) -> Option<String> {
    let KnownSpeed { bits_per_second, is_interval_only } = known_speed(transfers, bounds, direction)?;
    if !is_interval_only {
        return Some(throughput(bits_per_second));
    }
    interval(bits_per_second, delay?, bound_of(bounds, direction)?)
}

/// Returns the cell of the speed while sending in a direction, with its [`text`].
pub(crate) fn cell(kind: PlacementKind, window: &Window, direction: Direction) -> Cell {
    if kind != PlacementKind::Remote {
        return Cell::none("one host: nothing is sent");
    }
    let verdict = bound_of(&window.bounds, direction).and_then(clocks::verdict);
    let why = find_obstacle(verdict, window.counts.ok);
    let delay = window.value(&DirectionNodes::of(direction).delay);
    match text(&window.transfers, &window.bounds, direction, delay) {
        // If the speed is known although no delay was judged, `why` would claim that nothing was sent.
        Some(text) => Cell { text, title: verdict.and(why).map(str::to_owned) },
        None => Cell::none(why.unwrap_or("the sizes or the delays are not known")),
    }
}

/// Returns the traffic up and down in MB/s, as `0.976 / 0.003`.
pub(crate) fn traffic(kind: PlacementKind, window: &Window) -> Cell {
    if kind != PlacementKind::Remote {
        return Cell::none("one host: nothing is sent");
    }
    let directions = Direction::ALL.map(|direction| direction_traffic(window, direction));
    if directions.iter().all(Option::is_none) {
        return Cell::none("no successful iteration in this time");
    }
    let [up, down] = directions.map(|traffic| traffic.map_or_else(|| NONE.to_owned(), throughput));
    Cell { text: format!("{up} / {down}"), title: Some("up / down, of successful iterations".to_owned()) }
}

/// Returns the traffic of a direction in bits per second.
pub(crate) fn direction_traffic(window: &Window, direction: Direction) -> Option<f64> {
    window.transfers.of(direction)?.traffic(window.covered_s)
}

/// Returns the interval of a speed while sending in MB/s, from the statistics of the delays. `None` if a delay has no
/// interval.
fn interval(speed: f64, delay: &QuantityStatistics, accuracy: &DelayAccuracy) -> Option<String> {
    let interval = accuracy.interval_of_mean(delay)?;
    let ClockInterval { lo, hi, method } = interval.throughput_interval(speed, delay.mean);
    let text = throughput_between((lo, Some(hi)));
    Some(method.remark().map_or_else(|| text.clone(), |remark| format!("{text} ({remark})")))
}

#[cfg(test)]
mod tests {
    use peernet_logger::Name;
    use peernet_stream::OutcomeCounts;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn chart_of_idle_pipeline_has_verdict_of_its_last_minute() {
        let newest = samples::NOW.unix_seconds();
        let of = |hz, verdict| {
            let mut series = samples::pipeline("line", hz, 1.0, verdict, &[]).series;
            for second in series.iter_mut().map(Arc::make_mut) {
                // No iteration succeeds in the last minute. The delays before the minute of the last success are stale.
                match newest - second.at {
                    ..MINUTE_S => {
                        second.counts = OutcomeCounts::default();
                        second.verdicts = [VerdictCounts::default(); 2];
                    }
                    age if age >= 2 * MINUTE_S => {
                        second.verdicts.iter_mut().for_each(|counts| counts.add(Verdict::Stale, 1_000));
                    }
                    _ => {}
                }
            }
            Direction::ALL.map(|direction| obstacle_in(&series, direction))
        };
        assert_eq!(of(5.0, Verdict::Ok), [None; 2]);
        assert_eq!(of(5.0, Verdict::Limited), [Some("known only within its clock bound"); 2]);
        assert_eq!(of(0.0, Verdict::Ok), [Some("no successful iteration in this time"); 2]);
        assert_eq!(obstacle_in(&[], Direction::Up), Some("no successful iteration in this time"));
    }

    #[test]
    fn throughput_over_limited_delay_is_an_interval() {
        let text = |verdict| {
            cell(PlacementKind::Remote, &samples::window(10, 30.0, 1.0, verdict), Direction::Up).text
        };
        assert_eq!(text(Verdict::Ok), "23.8");
        assert_eq!(text(Verdict::Limited), "21.5 – 26.5");
        assert_eq!(text(Verdict::Inconsistent), "—");
        let of = |seconds: f64| samples::figures(seconds, 9);
        let accuracy = |ends: Option<[f64; 2]>| DelayAccuracy {
            stage: Name::from("upload"),
            half_width: Some(of(0.002)),
            ends: ends.map(|ends| ends.map(of)),
            verdicts: Vec::new(),
        };
        let interval = |ends| interval(8e6, &of(0.001), &accuracy(ends)).expect("bounded");
        assert_eq!(interval(Some([0.0005, 0.002])), "0.50 – 2.00");
        assert_eq!(interval(Some([0.0, 0.004])), "≥ 0.250");
        assert_eq!(interval(None), "≥ 0.333 (from half widths)");
    }
}
