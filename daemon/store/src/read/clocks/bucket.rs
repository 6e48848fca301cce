//! Summary of several seconds as one point.

use peernet_analysis::delays::{DelaySummary, merged_round_trip};
use peernet_clock::{Offset, RelatedClocks, Span, WallTime};
use peernet_stream::{ProbeCounts, RoundTrip};

use super::{Row, wall};
use crate::error::StoreError;
use crate::stored::ClockPoint;

/// The seconds of one bucket, summed up.
pub(super) struct Bucket {
    /// Number of the bucket since 1970.
    index: i64,
    /// Time and window of the newest second.
    newest: Option<(WallTime, u64)>,
    /// Offset with the widest bounds in the newest window.
    widest: Option<Offset>,
    probes: ProbeCounts,
    round_trips: Vec<RoundTrip>,
    up: DelaySummary,
    down: DelaySummary,
    clocks: RelatedClocks,
    proven_skew_ppm: Option<(f64, f64)>,
    grown_window: Option<Span>,
}

impl Bucket {
    pub(super) fn new(index: i64) -> Self {
        Self {
            index,
            newest: None,
            widest: None,
            probes: ProbeCounts::default(),
            round_trips: Vec::new(),
            up: DelaySummary::default(),
            down: DelaySummary::default(),
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
        if self.newest.is_some_and(|(_, previous)| previous != window) {
            // Values from before a step of a clock do not apply after it.
            self.widest = None;
        }
        // The offset is built only for rows that are used, because building it takes most of the time.
        if let Some(bounds) = row.bounds()
            && self.widest.as_ref().is_none_or(|widest| widest.bounds.width() <= bounds.width())
            && let Some(offset) = row.offset()?
        {
            self.widest = Some(offset);
        }
        self.probes = [self.probes, row.probes()].into_iter().sum();
        self.round_trips.extend(row.round_trip());
        row.up()?.iter().for_each(|second| self.up.add(second));
        row.down()?.iter().for_each(|second| self.down.add(second));
        self.newest = Some((wall(row.at_ns), window));
        self.clocks = row.clocks()?;
        self.proven_skew_ppm = row.proven_skew_min_ppm.zip(row.proven_skew_max_ppm);
        self.grown_window = self.grown_window.max(row.grown_window_ns.map(Span::from_nanos));
        Ok(())
    }

    /// Returns the bucket as a point; `None` if it is empty.
    pub(super) fn point(self, width: u32) -> Option<ClockPoint> {
        let (newest, window) = self.newest?;
        let end = self.index.saturating_add(1).saturating_mul(i64::from(width) * 1_000_000_000);
        Some(ClockPoint {
            // A point of one second has the stored offset, and so the stored time.
            at: if width == 1 { newest } else { wall(end) },
            window,
            offset: self.widest,
            probes: self.probes,
            round_trip: merged_round_trip(self.round_trips),
            up: self.up.second(),
            down: self.down.second(),
            clocks: self.clocks,
            proven_skew_ppm: self.proven_skew_ppm,
            grown_window: self.grown_window,
        })
    }
}
