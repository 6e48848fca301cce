//! Assumptions behind the bounds of one-way delays.

use peernet_store::DelayAssumptions;
use serde::Serialize;
use utoipa::ToSchema;

/// Assumptions behind the bounds of one-way delays, beside the exchanges between the two hosts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Assumptions {
    /// The clocks of edge and cloud that were related: `raw` (the free-running clocks of both), `raw-to-wall` (that of the edge and the
    /// wall clock of the cloud) or `wall` (the wall clocks of both, recorded before release 0.3.0).
    pub clocks: &'static str,
    /// Largest rate at which these clocks may drift apart, ρ; parts per million. Null where it was not reported.
    pub max_drift_ppm: Option<f64>,
    /// Largest change of that rate, κ; parts per million per second. Null where nothing was assumed of it.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// `true` if claims of time daemons may narrow the bounds; null where it was not reported (releases before 0.3.0).
    pub claims_trusted: Option<bool>,
    /// `true` if the probes were authenticated; null where there were none or it was not reported.
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
