//! Assumptions behind the bounds of one-way delays.

use peernet_store::DelayAssumptions;
use serde::Serialize;
use utoipa::ToSchema;

/// Assumptions on which the bounds of one-way delays depend, in addition to the exchanges between the two hosts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Assumptions {
    /// Clocks of edge and cloud that were related: `raw` (the free-running clocks of both), `raw-to-wall` (the free-running clock of the
    /// edge and the wall clock of the cloud) or `wall` (the wall clocks of both, recorded before release 0.3.0).
    pub clocks: &'static str,
    /// Maximum relative drift rate of these clocks, ρ, parts per million; null if not reported.
    pub max_drift_ppm: Option<f64>,
    /// Maximum change of that rate, κ, parts per million per second; null if nothing was assumed about it.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// `true` if claims of time daemons may narrow the bounds; null if not reported (before release 0.3.0).
    pub claims_trusted: Option<bool>,
    /// `true` if the probes were authenticated; null without probes, or if not reported.
    pub probes_authenticated: Option<bool>,
}

impl From<&DelayAssumptions> for Assumptions {
    fn from(assumptions: &DelayAssumptions) -> Self {
        let DelayAssumptions {
            clocks,
            max_drift_ppm,
            max_drift_change_ppm_per_s,
            claims_trusted,
            probes_authenticated,
        } = *assumptions;
        Self {
            clocks: clocks.name(),
            max_drift_ppm,
            max_drift_change_ppm_per_s,
            claims_trusted,
            probes_authenticated,
        }
    }
}
