//! Throughputs of the two directions, as far as their delays are known.

use peernet_aggregator::Window;
use peernet_clock::Verdict;
use peernet_logger::stream::PlacementKind;

use super::clocks;
use super::now::Cell;
use crate::numbers::throughput;

/// A direction of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    Up,
    Down,
}

impl Way {
    /// Name of the delay's node.
    pub(crate) const fn delay(self) -> &'static str {
        match self {
            Self::Up => "upload",
            Self::Down => "download",
        }
    }

    /// Name of the throughput's node.
    pub(crate) const fn throughput(self) -> &'static str {
        match self {
            Self::Up => "upload-throughput",
            Self::Down => "download-throughput",
        }
    }
}

/// Why there is no single figure for a direction; `None` when there is one.
pub(crate) fn obstacle(window: &Window, way: Way) -> Option<&'static str> {
    let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
    match bound.and_then(clocks::verdict) {
        Some(Verdict::Ok) => None,
        Some(Verdict::Limited) => Some("known only within its clock bound"),
        Some(_) => Some("the clocks do not tell this direction's delay"),
        None if window.counts.ok == 0 => Some("no successful iteration in this time"),
        None => Some("nothing was sent in this direction"),
    }
}

/// The throughput of a direction in MB/s; over a delay that is known within a wide bound, the interval.
pub(crate) fn cell(kind: PlacementKind, window: &Window, way: Way) -> Cell {
    if kind != PlacementKind::Remote {
        return Cell::none("one host: nothing is sent");
    }
    let value = window.value(way.throughput());
    match (obstacle(window, way), value) {
        (None, Some(figures)) => Cell::new(throughput(figures.mean)),
        (None, None) => Cell::none("no throughput was computed"),
        (Some(why), value) => {
            let bound = window.bounds.iter().find(|bound| bound.stage == *way.delay());
            let half = bound.and_then(|bound| bound.half_width).map(|width| width.p50);
            let delay = window.value(way.delay()).map(|figures| figures.mean);
            let limited = bound.and_then(clocks::verdict) == Some(Verdict::Limited);
            match value.filter(|_| limited).and_then(|value| interval(value.mean, delay, half)) {
                Some(text) => Cell { text, title: Some(why.to_owned()) },
                None => Cell::none(why),
            }
        }
    }
}

/// The throughput that follows from the ends of a delay's interval, in MB/s: `12.0 – ∞` where the
/// delay may be nothing; `None` where the delay has no bound.
pub(crate) fn interval(rate: f64, delay: Option<f64>, half: Option<f64>) -> Option<String> {
    let (delay, half) = delay.zip(half)?;
    let hi = if half < delay { throughput(rate * delay / (delay - half)) } else { "∞".to_owned() };
    Some(format!("{} – {hi}", throughput(rate * delay / (delay + half))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::samples;

    #[test]
    fn a_throughput_over_a_limited_delay_is_an_interval() {
        let text =
            |verdict| cell(PlacementKind::Remote, &samples::window(10, 30.0, 1.0, verdict), Way::Up).text;
        assert_eq!(text(Verdict::Ok), "23.8");
        assert_eq!(text(Verdict::Limited), "21.5 – 26.5");
        assert_eq!(text(Verdict::Inconsistent), "—");
        assert_eq!(interval(8e6, Some(0.001), Some(0.002)).expect("bounded"), "0.33 – ∞");
    }
}
