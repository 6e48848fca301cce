//! Several seconds as one point.

use peernet_clock::{Offset, RelatedClocks, Span, Verdict, WallTime};
use peernet_stream::{DelayPoint, DelaySecond, ProbeCounts, RoundTrip};

use super::{Row, wall};
use crate::error::StoreError;
use crate::stored::ClockPoint;

/// A verdict counts for a bucket when at least one delay in so many was given it or a worse one.
const WORST_OF: u64 = 20;

/// The seconds of one bucket, summed up.
pub(super) struct Bucket {
    index: i64,
    /// Time and window.
    newest: Option<(WallTime, u64)>,
    widest: Option<Offset>,
    probes: ProbeCounts,
    shortest: Option<Span>,
    round_trips: Vec<Span>,
    up: Delays,
    down: Delays,
    clocks: RelatedClocks,
    proven_skew_ppm: Option<(f64, f64)>,
    grown_window: Option<Span>,
}

/// The delays of one direction.
#[derive(Default)]
struct Delays {
    count: u32,
    medians: Vec<DelayPoint>,
    verdicts: [u64; Verdict::ALL.len()],
}

impl Bucket {
    pub(super) fn new(index: i64) -> Self {
        Self {
            index,
            newest: None,
            widest: None,
            probes: ProbeCounts::default(),
            shortest: None,
            round_trips: Vec::new(),
            up: Delays::default(),
            down: Delays::default(),
            clocks: RelatedClocks::Wall,
            proven_skew_ppm: None,
            grown_window: None,
        }
    }

    pub(super) fn index(&self) -> i64 {
        self.index
    }

    pub(super) fn add(&mut self, row: &Row) -> Result<(), StoreError> {
        let window = row.window.cast_unsigned();
        if self.newest.is_some_and(|(_, before)| before != window) {
            // What held before a step is not what holds after it.
            self.widest = None;
        }
        // Made of a row only when it counts: that is what takes time.
        if let Some(bounds) = row.bounds()
            && self.widest.as_ref().is_none_or(|widest| widest.bounds.width() <= bounds.width())
            && let Some(offset) = row.offset()?
        {
            self.widest = Some(offset);
        }
        self.probes.sent = self.probes.sent.saturating_add(row.probes_sent);
        self.probes.answered = self.probes.answered.saturating_add(row.probes_answered);
        self.probes.lost = self.probes.lost.saturating_add(row.probes_lost);
        self.probes.refused = self.probes.refused.saturating_add(row.probes_refused);
        if let Some(trip) = row.round_trip() {
            self.shortest = Some(self.shortest.map_or(trip.min, |shortest| shortest.min(trip.min)));
            self.round_trips.push(trip.median);
        }
        self.up.add(row.up()?);
        self.down.add(row.down()?);
        self.newest = Some((wall(row.at_ns), window));
        self.clocks = row.clocks()?;
        self.proven_skew_ppm = row.proven_skew_min_ppm.zip(row.proven_skew_max_ppm);
        self.grown_window = self.grown_window.max(row.grown_window_ns.map(Span::from_nanos));
        Ok(())
    }

    /// The bucket as a point; `None` when it is empty.
    pub(super) fn point(mut self, width: u32) -> Option<ClockPoint> {
        let (newest, window) = self.newest?;
        let end = self.index.saturating_add(1).saturating_mul(i64::from(width) * 1_000_000_000);
        let median = median(&mut self.round_trips, |trip| *trip);
        Some(ClockPoint {
            // As stored where a second is a point.
            at: if width == 1 { newest } else { wall(end) },
            window,
            offset: self.widest,
            probes: self.probes,
            round_trip: self.shortest.zip(median).map(|(min, median)| RoundTrip { min, median }),
            up: self.up.second(),
            down: self.down.second(),
            clocks: self.clocks,
            proven_skew_ppm: self.proven_skew_ppm,
            grown_window: self.grown_window,
        })
    }
}

impl Delays {
    fn add(&mut self, second: Option<DelaySecond>) {
        let Some(second) = second else { return };
        self.count = self.count.saturating_add(second.count);
        self.medians.extend(second.median);
        if let Some(at) = Verdict::ALL.iter().position(|known| *known == second.verdict) {
            // A second that was judged at all has a say.
            self.verdicts[at] += u64::from(second.count.max(1));
        }
    }

    fn second(mut self) -> Option<DelaySecond> {
        let all: u64 = self.verdicts.iter().sum();
        let mut worse = 0;
        let (verdict, _) = Verdict::ALL.iter().zip(self.verdicts).rev().find(|(_, times)| {
            worse += times;
            worse > 0 && worse * WORST_OF >= all
        })?;
        let median = median(&mut self.medians, |point| point.value);
        Some(DelaySecond { count: self.count, median, verdict: *verdict })
    }
}

/// The middle one; of two in the middle the smaller.
fn median<T: Copy>(items: &mut [T], by: impl Fn(&T) -> Span) -> Option<T> {
    items.sort_unstable_by_key(&by);
    items.get(items.len().saturating_sub(1) / 2).copied()
}
