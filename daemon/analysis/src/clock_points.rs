//! The relation of two clocks over time: points, each of which covers a second or longer, and the merging of several
//! points into one.

use std::convert::Infallible;

use peernet_clock::{Offset, RelatedClocks, Span, WallTime};
use peernet_stream::{DelaySecond, ProbeCounts, RoundTrip};
use serde::Serialize;

use crate::delays::{DelaySummary, merged_round_trip};

/// The relation of two clocks at one time, and the state of the network between their hosts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockPoint {
    /// End of the second that the point covers, on the edge's wall clock. For a bucket, the end of its newest second.
    pub at: WallTime,
    /// Number of the relation period: a period between two steps of a clock, in which one clock relation holds.
    #[serde(rename = "window")]
    pub relation_period: u64,
    /// The cloud's clock minus the edge's clock, with bounds; `None` while unknown. For a bucket of several points, the
    /// offset with the widest bounds.
    pub offset: Option<Offset>,
    /// Numbers of probes that were sent, answered, lost and refused.
    pub probes: ProbeCounts,
    /// Round trips of probes.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data, edge to cloud.
    pub up: Option<DelaySecond>,
    /// Delays of data, cloud to edge.
    pub down: Option<DelaySecond>,
    /// Kind of the two related clocks: wall clocks, or free-running clocks.
    pub clocks: RelatedClocks,
    /// Lowest and highest difference between the rates of the related clocks that the exchanges allow, parts per
    /// million; `None` while unknown. For a bucket of several points, the newest value.
    pub proven_skew_ppm: Option<(f64, f64)>,
    /// Age of the oldest exchange that is used; `None` unless this age is greater than `[clock] window_s`. For a bucket
    /// of several points, the greatest age.
    #[serde(rename = "grown_window")]
    pub oldest_exchange_age: Option<Span>,
}

/// Points of one bucket, summed up in order of time.
#[derive(Clone, Debug, Default)]
pub struct ClockBucket {
    /// Time and [`ClockPoint::relation_period`] of the newest point.
    newest: Option<(WallTime, u64)>,
    /// Offset with the widest bounds among the points of the newest relation period. Among equal widths, the newest
    /// offset.
    widest: Option<Offset>,
    probes: ProbeCounts,
    round_trips: Vec<RoundTrip>,
    up: DelaySummary,
    down: DelaySummary,
    clocks: Option<RelatedClocks>,
    proven_skew_ppm: Option<(f64, f64)>,
    oldest_exchange_age: Option<Span>,
}

impl ClockBucket {
    /// Adds a point. `point.offset` is ignored: `load_offset` returns the offset of the point
    /// instead. `load_offset` is called only if the bucket needs the offset, because building an
    /// offset from a stored row takes most of the time. `width` is the width of the offset's
    /// bounds; `None` without an offset.
    ///
    /// # Errors
    /// The error of `load_offset`.
    pub fn add_with<E>(
        &mut self,
        point: &ClockPoint,
        width: Option<Span>,
        load_offset: impl FnOnce() -> Result<Option<Offset>, E>,
    ) -> Result<(), E> {
        if self.newest.is_some_and(|(_, previous)| previous != point.relation_period) {
            // An offset from before a step of a clock does not apply after the step.
            self.widest = None;
        }
        if let Some(width) = width
            && self.widest.as_ref().is_none_or(|widest| widest.bounds.width() <= width)
            && let Some(offset) = load_offset()?
        {
            self.widest = Some(offset);
        }
        self.probes = [self.probes, point.probes].into_iter().sum();
        self.round_trips.extend(point.round_trip);
        point.up.iter().for_each(|second| self.up.add(second));
        point.down.iter().for_each(|second| self.down.add(second));
        self.newest = Some((point.at, point.relation_period));
        self.clocks = Some(point.clocks);
        self.proven_skew_ppm = point.proven_skew_ppm;
        self.oldest_exchange_age = self.oldest_exchange_age.max(point.oldest_exchange_age);
        Ok(())
    }

    /// Adds a point with its offset.
    pub fn add(&mut self, point: &ClockPoint) {
        let width = point.offset.as_ref().map(|offset| offset.bounds.width());
        let Ok(()) = self.add_with(point, width, || Ok::<_, Infallible>(point.offset.clone()));
    }

    /// Returns the bucket as one point, at the time of the newest point in it; `None` if the bucket is empty.
    pub fn into_point(self) -> Option<ClockPoint> {
        let (at, relation_period) = self.newest?;
        Some(ClockPoint {
            at,
            relation_period,
            offset: self.widest,
            probes: self.probes,
            round_trip: merged_round_trip(self.round_trips),
            up: self.up.to_delay_second(),
            down: self.down.to_delay_second(),
            clocks: self.clocks?,
            proven_skew_ppm: self.proven_skew_ppm,
            oldest_exchange_age: self.oldest_exchange_age,
        })
    }
}

/// Returns the number of the bucket of a point, counted from 1970. The time of a point is its end, and the end of a
/// bucket belongs to the bucket.
pub fn bucket_number(at: WallTime, width_s: u32) -> i64 {
    at.unix_nanos().saturating_sub(1).div_euclid(i64::from(width_s.max(1)) * 1_000_000_000)
}
