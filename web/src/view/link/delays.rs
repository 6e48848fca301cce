//! Statistics of the one-way delays of one direction over a few seconds.

use peernet_analysis::delays::DelaySummary;
use peernet_clock::{Direction, Verdict};
use peernet_statistics::number::{NONE, within_ms};
use peernet_store::ClockPoint;
use peernet_stream::{DelayPoint, DelaySecond};

use super::super::chip::Chip;
use super::super::clocks;

/// Statistics of the delays of one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Delays {
    pub direction: Direction,
    /// Number of delays.
    pub count: u64,
    /// Median delay, with the median of all lower bounds and the median of all upper bounds; `None` without known
    /// delays.
    pub median: Option<DelayPoint>,
    /// Verdict on the delays: the worst verdict for which at least 5 % of the delays have this verdict or a worse one.
    /// All delays of a second count with the verdict on that second, because the verdicts on single delays are not
    /// reported.
    pub verdict: Option<Verdict>,
}

/// Returns the delays of a direction in the seconds of one point; `None` if nothing was sent.
pub(crate) fn delays_of_point(point: &ClockPoint, direction: Direction) -> Option<&DelaySecond> {
    match direction {
        Direction::Up => point.up.as_ref(),
        Direction::Down => point.down.as_ref(),
    }
}

/// Returns the lower and the upper bound of a delay, seconds. Negative bounds become zero, because no message arrives
/// before it was sent.
pub(crate) fn non_negative_bounds(point: &DelayPoint) -> (f64, f64) {
    (point.bounds.lo.seconds().max(0.0), point.bounds.hi.seconds().max(0.0))
}

/// Returns a delay in ms with the digits that its bounds support.
pub(super) fn format_delay(point: &DelayPoint) -> String {
    within_ms(point.value.seconds(), non_negative_bounds(point))
}

impl Delays {
    /// Returns the delays of some points.
    pub(crate) fn of<'a>(direction: Direction, points: impl IntoIterator<Item = &'a ClockPoint>) -> Self {
        let seconds: Vec<DelaySecond> =
            points.into_iter().filter_map(|point| delays_of_point(point, direction).copied()).collect();
        Self::merge(direction, &seconds)
    }

    /// Combines the delays of several seconds.
    pub(crate) fn merge(direction: Direction, seconds: &[DelaySecond]) -> Self {
        let summary: DelaySummary = seconds.iter().collect();
        Self { direction, count: summary.count(), median: summary.median(), verdict: summary.verdict() }
    }

    /// Returns the name of the stage for the start of a sentence.
    pub(crate) const fn title(&self) -> &'static str {
        match self.direction {
            Direction::Up => "Upload",
            Direction::Down => "Download",
        }
    }

    /// Returns the chip of the verdict.
    pub(crate) fn chip(&self) -> Option<Chip> {
        self.verdict.map(Chip::verdict)
    }

    /// Returns the median in ms, or a dash.
    pub(crate) fn value(&self) -> String {
        self.median.map_or_else(|| NONE.to_owned(), |point| format_delay(&point))
    }

    /// Returns the interval that contains the median, in ms; `None` without a median.
    pub(crate) fn interval(&self) -> Option<String> {
        Some(clocks::interval_text(non_negative_bounds(self.median.as_ref()?)))
    }

    /// Returns the reason why there is no median.
    pub(crate) fn reason(&self) -> &'static str {
        match self.verdict {
            None => "nothing was sent in the last 10 s",
            Some(verdict) => clocks::meaning(verdict),
        }
    }
}
