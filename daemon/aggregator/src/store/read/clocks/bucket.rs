//! Several seconds as one point.

use peernet_clock::{Offset, Span, Verdict};
use peernet_logger::stream::{DelayPoint, DelaySecond, ProbeCounts, RoundTrip};

use super::{Row, wall};
use crate::error::StoreError;
use crate::picture::ClockPoint;

/// A verdict counts for a bucket when at least one delay in so many was given it or a worse one.
const WORST_OF: u64 = 20;

/// The seconds of one bucket, summed up.
pub(super) struct Bucket {
    index: i64,
    newest: Option<ClockPoint>,
    widest: Option<Offset>,
    probes: ProbeCounts,
    shortest: Option<Span>,
    round_trips: Vec<Span>,
    up: Delays,
    down: Delays,
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
        }
    }

    pub(super) fn index(&self) -> i64 {
        self.index
    }

    pub(super) fn add(&mut self, row: Row) -> Result<(), StoreError> {
        let point = row.point()?;
        let width = |offset: &Offset| offset.bounds.width();
        if self.newest.as_ref().is_some_and(|newest| newest.window != point.window) {
            // What held before a step is not what holds after it.
            self.widest = None;
        }
        if let Some(offset) = &point.offset
            && self.widest.as_ref().is_none_or(|widest| width(widest) <= width(offset))
        {
            self.widest = Some(offset.clone());
        }
        self.probes.sent = self.probes.sent.saturating_add(point.probes.sent);
        self.probes.answered = self.probes.answered.saturating_add(point.probes.answered);
        self.probes.lost = self.probes.lost.saturating_add(point.probes.lost);
        if let Some(trip) = point.round_trip {
            self.shortest = Some(self.shortest.map_or(trip.min, |shortest| shortest.min(trip.min)));
            self.round_trips.push(trip.median);
        }
        self.up.add(point.up);
        self.down.add(point.down);
        self.newest = Some(point);
        Ok(())
    }

    /// The bucket as a point; `None` when it is empty.
    pub(super) fn point(mut self, width: u32) -> Option<ClockPoint> {
        let newest = self.newest?;
        let end = self.index.saturating_add(1).saturating_mul(i64::from(width) * 1_000_000_000);
        let median = median(&mut self.round_trips, |trip| *trip);
        Some(ClockPoint {
            // As stored where a second is a point.
            at: if width == 1 { newest.at } else { wall(end) },
            window: newest.window,
            offset: self.widest,
            probes: self.probes,
            round_trip: self.shortest.zip(median).map(|(min, median)| RoundTrip { min, median }),
            up: self.up.second(),
            down: self.down.second(),
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
