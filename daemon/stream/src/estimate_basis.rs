//! The assumptions and the evidence that the bounds of a second rest on.

use peernet_clock::{RawTime, RelatedClocks, Span};
use serde::{Deserialize, Serialize};

/// What the bounds of a second of a link rest on, beside its exchanges and the limit of drift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EstimateBasis {
    /// The clocks that the stamps of the exchanges are of.
    pub clocks: RelatedClocks,
    /// The edge's free-running clock at the end of the second, when its wall clock showed the sample's time; `None` where it was not read.
    pub at_raw: Option<RawTime>,
    /// The limit of how fast the rate between the two clocks changes, parts per million per second; `None` where none is assumed:
    /// then an exchange bounds other times by the limit of drift alone.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// The lowest and the highest rate between the two clocks that the exchanges allow, parts per million; `None` while they
    /// prove nothing.
    pub proven_skew_ppm: Option<(f64, f64)>,
    /// How old the oldest exchange is that bounds the offset; `None` where it is not older than the configured window.
    pub grown_window: Option<Span>,
    /// Whether what both hosts' time daemons claim may narrow the interval.
    pub claims_trusted: bool,
    /// Whether the probes are authenticated; `None` where the link is not probed.
    pub probes_authenticated: Option<bool>,
}
