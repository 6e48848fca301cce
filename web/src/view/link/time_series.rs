//! The time series of a link.

use std::sync::Arc;

use peernet_analysis::clock_points::{ClockBucket, bucket_number};
use peernet_analysis::delays::merged_round_trip;
use peernet_clock::{RelatedClocks, Span, WallTime};
use peernet_store::{ClockPoint, ClockSeries};
use peernet_stream::{ProbeCounts, RoundTrip};

/// Length of the time series of a live link, seconds.
const LIVE_RANGE_S: i64 = 600;
/// Seconds of each point of a live link.
const LIVE_BUCKET_S: u32 = 2;

/// Time series of a link between two times of the edge's wall clock.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LinkTimeSeries {
    pub from: WallTime,
    pub to: WallTime,
    /// Seconds between points.
    pub bucket: i64,
    /// Points, oldest first. Times without data have no point.
    pub points: Vec<ClockPoint>,
}

impl LinkTimeSeries {
    /// Returns the last `seconds` seconds of a live link, with one point for every two seconds. The time series ends
    /// at a multiple of two seconds, so a chart of it changes only when a point is complete.
    pub(crate) fn live(history: &[Arc<ClockPoint>], end: WallTime, seconds: i64) -> Self {
        let (from, to) = live_range(end, seconds);
        let recent =
            history.iter().filter(|point| point.at > from && point.at <= to).map(|point| (**point).clone());
        Self { from, to, bucket: 1, points: recent.collect() }.merged(i64::from(LIVE_BUCKET_S))
    }

    /// Converts stored clock samples of a link. The range begins at `from`, or at the first point if the first point is
    /// later: the time before the first point is not a gap. The range lasts at least a minute, unless the time from
    /// `from` to `to` is shorter.
    pub(crate) fn stored(series: ClockSeries, from: WallTime, to: WallTime) -> Self {
        let bucket = i64::from(series.bucket_s.max(1));
        let first_begin = series.points.first().map(|point| point.at - Span::from_seconds(bucket));
        let latest_begin = to - Span::from_seconds(60);
        Self {
            from: first_begin.map_or(from, |first_begin| first_begin.min(latest_begin).max(from)),
            to,
            bucket,
            points: series.points,
        }
    }

    /// Returns the length of the time range, seconds.
    pub(crate) fn seconds(&self) -> f64 {
        (self.to - self.from).seconds()
    }

    /// Returns the time series with one point for each `seconds` seconds, merged from the points of these seconds.
    pub(crate) fn merged(&self, seconds: i64) -> Self {
        let seconds = seconds.max(1);
        let width = u32::try_from(seconds).unwrap_or(u32::MAX);
        let bucket = |point: &ClockPoint| bucket_number(point.at, width);
        let points = self.points.chunk_by(|a, b| bucket(a) == bucket(b)).filter_map(merge_points).collect();
        Self { bucket: self.bucket.max(seconds), points, ..*self }
    }

    /// Returns the beginning and the end of each gap. A gap begins at the last point before it, and ends at the first
    /// point after it or at the end of the time range.
    pub(crate) fn gaps(&self) -> Vec<(WallTime, WallTime)> {
        // Reports are not exactly periodic, so half a bucket and one second more than the usual distance are not a gap.
        let max_distance = Span::from_seconds_f64(self.bucket as f64 * 1.5 + 1.0);
        let between = self.points.windows(2).map(|pair| (pair[0].at, pair[1].at));
        let last = self.points.last().map(|point| (point.at, self.to));
        between.chain(last).filter(|(from, to)| *to - *from > max_distance).collect()
    }

    /// Converts a time of the cloud's wall clock to the edge's wall clock, with the offset that was measured nearest
    /// to that time. An offset of free-running clocks says nothing about wall clocks. Without an offset of wall
    /// clocks, returns the time unchanged.
    pub(crate) fn edge_time_at(&self, at: WallTime) -> WallTime {
        let of_wall_clocks = self.points.iter().filter(|point| point.clocks == RelatedClocks::Wall);
        let offsets = of_wall_clocks.filter_map(|point| point.offset.as_ref());
        let nearest = offsets.min_by_key(|offset| (at - (offset.at + offset.estimate)).abs());
        nearest.map_or(at, |offset| at - offset.estimate)
    }

    /// Returns the counts of probes of all points together.
    pub(crate) fn probes(&self) -> ProbeCounts {
        self.points.iter().map(|point| point.probes).sum()
    }

    /// Returns the smallest and the median round trip of probes, seconds.
    pub(crate) fn round_trips(&self) -> Option<(f64, f64)> {
        let trip = merged_round_trip(self.points.iter().filter_map(|point| point.round_trip))?;
        Some((trip.min.seconds(), trip.median.seconds()))
    }
}

/// Returns the time range of a live link that ends at `end`.
fn live_range(end: WallTime, seconds: i64) -> (WallTime, WallTime) {
    let bucket_ns = i64::from(LIVE_BUCKET_S) * 1_000_000_000;
    let to = WallTime::from_unix_nanos(end.unix_nanos().div_euclid(bucket_ns) * bucket_ns);
    (to - Span::from_seconds(seconds), to)
}

/// Returns the counts of probes and the newest round trip of the points that [`LinkTimeSeries::live`] returns for ten
/// minutes.
// A list of links needs only these values, and would take long if it merged all points of each link.
pub(crate) fn live_probes(history: &[Arc<ClockPoint>], end: WallTime) -> (ProbeCounts, Option<RoundTrip>) {
    let (from, to) = live_range(end, LIVE_RANGE_S);
    let recent = || history.iter().filter(move |point| point.at > from && point.at <= to);
    let bucket = |point: &ClockPoint| bucket_number(point.at, LIVE_BUCKET_S);
    let newest = recent().rev().find(|point| point.round_trip.is_some()).map(|point| bucket(point));
    let in_newest = recent().filter(|point| Some(bucket(point)) == newest);
    let trip = merged_round_trip(in_newest.filter_map(|point| point.round_trip));
    (recent().map(|point| point.probes).sum(), trip)
}

/// Merges several points into one, as the store merges seconds.
fn merge_points(points: &[ClockPoint]) -> Option<ClockPoint> {
    let mut bucket = ClockBucket::default();
    points.iter().for_each(|point| bucket.add(point));
    bucket.into_point()
}
