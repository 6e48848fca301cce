//! Error bounds that a host's time daemon claims for the wall clock.

use serde::{Deserialize, Serialize};

use crate::{DelaySource, Interval};

/// Claim of a time daemon about its host's wall clock: clock minus true time lies within an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockClaim {
    /// Source of the claim: [`DelaySource::Kernel`] or [`DelaySource::Chrony`].
    pub source: DelaySource,
    /// Error of the wall clock: clock minus true time.
    pub error: Interval,
}

impl ClockClaim {
    /// Returns the offset (cloud minus edge) by the claims of both hosts, and the source of the offset: chrony if at
    /// least one of the claims is chrony's, otherwise the source of the edge's claim.
    pub fn offset(edge: &Self, cloud: &Self) -> (DelaySource, Interval) {
        let is_chrony = [edge, cloud].iter().any(|claim| claim.source == DelaySource::Chrony);
        let source = if is_chrony { DelaySource::Chrony } else { edge.source };
        // The offset is the cloud's error minus the edge's error, so its bounds are the extreme differences.
        (source, Interval { lo: cloud.error.lo - edge.error.hi, hi: cloud.error.hi - edge.error.lo })
    }
}
