//! Types of the store that the live state also contains.

use peernet_clock::{Offset, RelatedClocks, Span, WallTime};
use peernet_stream::{DelaySecond, ProbeCounts, RoundTrip};
use serde::Serialize;

/// The relation of two clocks at one time, and the state of the network between their hosts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockPoint {
    /// End of the second (or of the bucket), on the edge's wall clock.
    pub at: WallTime,
    /// Number of the window; changes when a clock was stepped.
    pub window: u64,
    /// The cloud's clock minus the edge's clock, with bounds; `None` while unknown. In a bucket, the offset with the widest bounds.
    pub offset: Option<Offset>,
    /// Counts of probes.
    pub probes: ProbeCounts,
    /// Round trips of probes.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data, edge to cloud.
    pub up: Option<DelaySecond>,
    /// Delays of data, cloud to edge.
    pub down: Option<DelaySecond>,
    /// The related clocks.
    pub clocks: RelatedClocks,
    /// Lowest and highest rate between the related clocks that the exchanges allow, parts per million. In a bucket, the newest rates.
    pub proven_skew_ppm: Option<(f64, f64)>,
    /// Age of the oldest exchange that is used, if it is older than the configured window. In a bucket, the greatest age.
    pub grown_window: Option<Span>,
}

/// Counts of the stored data of one host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StoredCounts {
    /// Events of all kinds.
    pub events: u64,
    /// Nodes of iterations.
    pub nodes: u64,
    /// Gaps that the host reported or that were noticed in its streams.
    pub gaps: u64,
    /// Number of events in these gaps; events that could not be counted are not included.
    pub missing: u64,
    /// Batches that arrived more than once and were stored once, since the aggregator started.
    pub duplicates: u64,
    /// Batches that were quarantined because they could not be stored.
    pub quarantined: u64,
}
