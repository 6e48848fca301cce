//! Samples of a link over a time range.

use std::sync::Arc;

use peernet_analysis::delays::merged_round_trip;
use peernet_clock::{Offset, RelatedClocks, Span, WallTime};
use peernet_store::{ClockPoint, ClockSeries};
use peernet_stream::{DelaySecond, ProbeCounts};

use super::super::speed::NetworkDirection;
use super::delays::Delays;

/// Points between two moments of the edge's wall clock.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Course {
    pub from: WallTime,
    pub to: WallTime,
    /// Seconds between points.
    pub bucket: i64,
    /// Points, oldest first; missing points are absent.
    pub points: Vec<ClockPoint>,
}

impl Course {
    /// Returns the last seconds of a live link, two seconds a point. It ends with the last whole point, so that a picture of
    /// it changes no more often than there is something new.
    pub(crate) fn live(history: &[Arc<ClockPoint>], end: WallTime, seconds: i64) -> Self {
        let to = WallTime::from_unix_nanos(end.unix_nanos().div_euclid(2_000_000_000) * 2_000_000_000);
        let from = to - Span::from_seconds(seconds);
        let shown =
            history.iter().filter(|point| point.at > from && point.at <= to).map(|point| (**point).clone());
        Self { from, to, bucket: 1, points: shown.collect() }.thinned(2)
    }

    /// Converts stored samples of a link. The range begins with the first point if that is later, because nothing was lost before it, and has at
    /// least a minute.
    pub(crate) fn stored(series: ClockSeries, from: WallTime, to: WallTime) -> Self {
        let bucket = i64::from(series.bucket_s.max(1));
        let first = series.points.first().map(|point| point.at - Span::from_seconds(bucket));
        let least = to - Span::from_seconds(60);
        Self {
            from: first.map_or(from, |first| first.min(least).max(from)),
            to,
            bucket,
            points: series.points,
        }
    }

    /// Returns the seconds from its begin to its end.
    pub(crate) fn seconds(&self) -> f64 {
        (self.to - self.from).seconds()
    }

    /// Merges points so that each covers `seconds` seconds.
    pub(crate) fn thinned(&self, seconds: i64) -> Self {
        let seconds = seconds.max(1);
        // The time of a point is its end, so a point at the end of a bucket belongs to this bucket.
        let bucket = |point: &ClockPoint| (point.at.unix_nanos() - 1).div_euclid(seconds * 1_000_000_000);
        let points = self.points.chunk_by(|a, b| bucket(a) == bucket(b)).filter_map(merge_points).collect();
        Self { bucket: self.bucket.max(seconds), points, ..*self }
    }

    /// Returns the times without points: from the last point before to the first one after.
    pub(crate) fn gaps(&self) -> Vec<(WallTime, WallTime)> {
        let usual = Span::from_seconds_f64(self.bucket as f64 * 1.5 + 1.0);
        let between = self.points.windows(2).map(|pair| (pair[0].at, pair[1].at));
        let last = self.points.last().map(|point| (point.at, self.to));
        between.chain(last).filter(|(from, to)| *to - *from > usual).collect()
    }

    /// Returns the time of the edge's wall clock when the cloud's showed `at`, by the offset known nearest to that moment. An offset of
    /// free-running clocks says nothing about wall clocks: then both are taken to show the same time.
    pub(crate) fn on_the_edge(&self, at: WallTime) -> WallTime {
        let of_wall_clocks = self.points.iter().filter(|point| point.clocks == RelatedClocks::Wall);
        let known = of_wall_clocks.filter_map(|point| point.offset.as_ref());
        let nearest = known.min_by_key(|offset| (at - (offset.at + offset.estimate)).abs());
        nearest.map_or(at, |offset| at - offset.estimate)
    }

    /// Returns the probes of the whole course.
    pub(crate) fn probes(&self) -> ProbeCounts {
        sum(self.points.iter().map(|point| point.probes))
    }

    /// Returns the smallest and the middle round trip of probes, seconds.
    pub(crate) fn round_trips(&self) -> Option<(f64, f64)> {
        let trip = merged_round_trip(self.points.iter().filter_map(|point| point.round_trip))?;
        Some((trip.min.seconds(), trip.median.seconds()))
    }
}

/// Adds up counts of probes.
pub(super) fn sum(counts: impl Iterator<Item = ProbeCounts>) -> ProbeCounts {
    counts.fold(ProbeCounts::default(), |sum, one| ProbeCounts {
        sent: sum.sent.saturating_add(one.sent),
        answered: sum.answered.saturating_add(one.answered),
        lost: sum.lost.saturating_add(one.lost),
        refused: sum.refused.saturating_add(one.refused),
    })
}

/// Returns the offset with the widest bounds, and among equal widths the newest. The store's buckets follow the same rule.
fn widest_offset(points: &[ClockPoint]) -> Option<Offset> {
    let known = points.iter().filter_map(|point| point.offset.as_ref());
    known.max_by_key(|offset| offset.bounds.width()).cloned()
}

fn delays(points: &[ClockPoint], way: NetworkDirection) -> Option<DelaySecond> {
    let delays = Delays::of(way, points);
    let count = u32::try_from(delays.count).unwrap_or(u32::MAX);
    Some(DelaySecond { count, median: delays.median, verdict: delays.verdict? })
}

/// Merges several points into one.
fn merge_points(points: &[ClockPoint]) -> Option<ClockPoint> {
    let last = points.last()?;
    if points.len() == 1 {
        return Some(last.clone());
    }
    // Samples from before a step say nothing about the offset after it.
    let begin = points.iter().rposition(|point| point.window != last.window).map_or(0, |at| at + 1);
    Some(ClockPoint {
        at: last.at,
        window: last.window,
        offset: widest_offset(&points[begin..]),
        probes: sum(points.iter().map(|point| point.probes)),
        round_trip: merged_round_trip(points.iter().filter_map(|point| point.round_trip)),
        up: delays(points, NetworkDirection::Up),
        down: delays(points, NetworkDirection::Down),
        clocks: last.clocks,
        proven_skew_ppm: last.proven_skew_ppm,
        grown_window: points.iter().filter_map(|point| point.grown_window).max(),
    })
}
