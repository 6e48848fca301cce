//! Types of the store that the live picture contains.

use peernet_clock::{Offset, RelatedClocks, Span, WallTime};
use peernet_stream::{DelaySecond, ProbeCounts, RoundTrip};
use serde::Serialize;

/// What was known of two clocks at one time, and what the network did meanwhile.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockPoint {
    /// The end of the second (or of the bucket), on the edge's wall clock.
    pub at: WallTime,
    /// Changes when a clock was stepped.
    pub window: u64,
    /// Cloud minus edge with its bounds; `None` while nothing was known. Of a bucket the widest bounds.
    pub offset: Option<Offset>,
    /// Probes.
    pub probes: ProbeCounts,
    /// Round trips of probes.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data, edge to cloud.
    pub up: Option<DelaySecond>,
    /// Cloud to edge.
    pub down: Option<DelaySecond>,
    /// The clocks that the offset is between.
    pub clocks: RelatedClocks,
    /// The lowest and the highest rate between them that the exchanges allow, parts per million; of a bucket the newest.
    pub proven_skew_ppm: Option<(f64, f64)>,
    /// The age of the oldest exchange that counts, where it is beyond the configured window; of a bucket the greatest.
    pub grown_window: Option<Span>,
}

/// What the database holds of one host, since it first came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Stored {
    /// Events of all kinds.
    pub events: u64,
    /// Nodes of iterations.
    pub nodes: u64,
    /// Gaps that the host reported or that were noticed in its streams.
    pub gaps: u64,
    /// Events missing in those gaps, as far as they could be counted.
    pub missing: u64,
    /// Batches that came more than once and were stored once; since the aggregator started.
    pub duplicates: u64,
    /// Batches put aside because they could not be stored as they were.
    pub quarantined: u64,
}
