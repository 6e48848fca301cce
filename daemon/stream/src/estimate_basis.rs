//! Assumptions and evidence from which the bounds of a second are computed.

use peernet_clock::{RawTime, RelatedClocks, Span};
use serde::{Deserialize, Serialize};

/// Assumptions and evidence from which the bounds of a second of a link are computed, in addition to its exchanges and
/// the limit of drift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EstimateBasis {
    /// Clocks that stamped the exchanges.
    pub clocks: RelatedClocks,
    /// Time of the edge's free-running clock at the end of the second ([`ClockSample::at`](crate::ClockSample::at));
    /// `None` if this clock was not read.
    pub at_raw: Option<RawTime>,
    /// Limit of the change of the rate between the two clocks, parts per million per second; `None` if no limit is
    /// assumed. In that case, only the limit of drift determines how an exchange bounds the offset at other times.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// Lowest and highest rate between the two clocks that the exchanges allow, parts per million; `None` if they prove
    /// nothing.
    pub proven_skew_ppm: Option<(f64, f64)>,
    /// Age of the oldest exchange that bounds the offset; `None` if this exchange is not older than the
    /// configured `[clock] window_s`.
    #[serde(rename = "grown_window")]
    pub oldest_exchange_age: Option<Span>,
    /// `true` if the claims of both hosts' time daemons may narrow the interval.
    pub claims_trusted: bool,
    /// `true` if the probes are authenticated; `None` if the link is not probed.
    pub probes_authenticated: Option<bool>,
}
