//! Speeds while sending and traffic of the two directions, as far as their delays are known.
//!
//! *Speed while sending* is the bytes over the time that they were on their way, *traffic* the bytes over wall time.

use std::sync::Arc;

use peernet_aggregator::{LiveSecond, Window};
use peernet_analysis::delays::prevailing_verdict;
use peernet_analysis::transfer::{Transfer, Transfers, speed_between};
use peernet_clock::Verdict;
use peernet_statistics::number::{NONE, throughput, throughput_between};
use peernet_stream::PlacementKind;

use super::clocks;
use super::now::Cell;

const MINUTE_S: i64 = 60;

/// A direction of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NetworkDirection {
    Up,
    Down,
}

impl NetworkDirection {
    /// Returns the name of the delay's node.
    pub(crate) const fn delay(self) -> &'static str {
        match self {
            Self::Up => "upload",
            Self::Down => "download",
        }
    }

    /// Returns the messages sent in this direction.
    pub(crate) const fn of(self, transfers: &Transfers) -> Option<Transfer> {
        match self {
            Self::Up => transfers.up,
            Self::Down => transfers.down,
        }
    }
}

/// Returns the reason why there is no single figure for a direction; `None` when there is one.
pub(crate) fn obstacle(window: &Window, way: NetworkDirection) -> Option<&'static str> {
    let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
    told(bound.and_then(clocks::verdict), window.counts.ok)
}

/// Returns the reason for a chart of these seconds, by the last minute with answered iterations, however long ago that is.
pub(crate) fn obstacle_in(series: &[Arc<LiveSecond>], way: NetworkDirection) -> Option<&'static str> {
    let last = series.iter().rfind(|second| second.counts.ok > 0).map(|second| second.at);
    let minute = || series.iter().filter(|second| last.is_some_and(|last| second.at > last - MINUTE_S));
    let given = |verdict: &Verdict| {
        let of_way = minute().flat_map(|second| &second.verdicts);
        let of_way = of_way.filter(|(stage, known, _)| *stage == *way.delay() && known == verdict);
        (*verdict, of_way.map(|(.., count)| count).sum())
    };
    let verdicts: Vec<(Verdict, u64)> = Verdict::ALL.iter().map(given).collect();
    told(prevailing_verdict(&verdicts), minute().map(|second| second.counts.ok).sum())
}

fn told(verdict: Option<Verdict>, ok: u64) -> Option<&'static str> {
    match verdict {
        Some(Verdict::Ok) => None,
        Some(Verdict::Limited) => Some("known only within its clock bound"),
        Some(_) => Some("the clocks do not tell this direction's delay"),
        None if ok == 0 => Some("no successful iteration in this time"),
        None => Some("nothing was sent in this direction"),
    }
}

/// Returns the speed while sending in a direction in MB/s; over a delay that is known within a wide bound, the interval.
pub(crate) fn cell(kind: PlacementKind, window: &Window, way: NetworkDirection) -> Cell {
    if kind != PlacementKind::Remote {
        return Cell::none("one host: nothing is sent");
    }
    let speed = way.of(&window.transfers).and_then(|transfer| transfer.speed());
    match (obstacle(window, way), speed) {
        (None, Some(speed)) => Cell::new(throughput(speed)),
        (None, None) => Cell::none("the sizes or the delays are not known"),
        (Some(why), speed) => {
            let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
            let half = bound.and_then(|bound| bound.half_width).map(|width| width.p50);
            let delay = window.value(way.delay()).map(|figures| figures.mean);
            let limited = bound.and_then(clocks::verdict) == Some(Verdict::Limited);
            match speed.filter(|_| limited).and_then(|speed| interval(speed, delay, half)) {
                Some(text) => Cell { text, title: Some(why.to_owned()) },
                None => Cell::none(why),
            }
        }
    }
}

/// Returns the traffic up and down in MB/s, as `0.976 / 0.003`.
pub(crate) fn traffic(kind: PlacementKind, window: &Window) -> Cell {
    if kind != PlacementKind::Remote {
        return Cell::none("one host: nothing is sent");
    }
    let ways = [NetworkDirection::Up, NetworkDirection::Down].map(|way| carried(window, way));
    if ways.iter().all(Option::is_none) {
        return Cell::none("no successful iteration in this time");
    }
    let [up, down] = ways.map(|carried| carried.map_or_else(|| NONE.to_owned(), throughput));
    Cell { text: format!("{up} / {down}"), title: Some("up / down, of successful iterations".to_owned()) }
}

/// Returns the traffic of a direction in bits per second.
pub(crate) fn carried(window: &Window, way: NetworkDirection) -> Option<f64> {
    way.of(&window.transfers)?.traffic(window.covered_s)
}

/// Returns the throughput that follows from the ends of a delay's interval, in MB/s; `None` where the delay has no bound.
pub(crate) fn interval(rate: f64, delay: Option<f64>, half: Option<f64>) -> Option<String> {
    let (delay, half) = delay.zip(half)?;
    Some(throughput_between(speed_between(rate, delay, half)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn a_chart_of_a_run_that_is_over_still_knows_its_directions() {
        let of = |hz, verdict| {
            let mut line = samples::pipeline("line", hz, 1.0, verdict, &[]);
            // Nothing was measured for a minute.
            line.windows = [1, 10, 60].map(|seconds| samples::window(seconds, 0.0, 1.0, verdict));
            [NetworkDirection::Up, NetworkDirection::Down].map(|way| obstacle_in(&line.series, way))
        };
        assert_eq!(of(5.0, Verdict::Ok), [None; 2]);
        assert_eq!(of(5.0, Verdict::Limited), [Some("known only within its clock bound"); 2]);
        assert_eq!(of(0.0, Verdict::Ok), [Some("no successful iteration in this time"); 2]);
        assert_eq!(obstacle_in(&[], NetworkDirection::Up), Some("no successful iteration in this time"));
    }

    #[test]
    fn a_throughput_over_a_limited_delay_is_an_interval() {
        let text = |verdict| {
            cell(PlacementKind::Remote, &samples::window(10, 30.0, 1.0, verdict), NetworkDirection::Up).text
        };
        assert_eq!(text(Verdict::Ok), "23.8");
        assert_eq!(text(Verdict::Limited), "21.5 – 26.5");
        assert_eq!(text(Verdict::Inconsistent), "—");
        assert_eq!(interval(8e6, Some(0.001), Some(0.002)).expect("bounded"), "≥ 0.333");
    }
}
