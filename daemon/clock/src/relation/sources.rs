//! Combination of several sources by intersection (RFC 5905, section 11.2.1, after Marzullo 1984).
//!
//! If two sources are right, the offset lies in the overlap of their intervals. If the intervals do not overlap, at
//! least one source is wrong. The result is then marked as inconsistent; the sources are not averaged.

use crate::band::DriftLimit;
use crate::{ClockClaim, DelaySource, Interval, RawTime, Span};

/// Current claims of the two hosts' time daemons.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims {
    pub(super) edge: Option<ClockClaim>,
    pub(super) cloud: Option<ClockClaim>,
    /// Time on the edge's clock at which the claims hold.
    pub(super) at: RawTime,
}

impl Claims {
    /// Returns the offset at a time that follows from both claims together, and its source; `None` if a claim is missing.
    /// The interval contains the drift between the time of the claims and `at`.
    pub(super) fn offset_at(&self, at: RawTime, limit: DriftLimit) -> Option<(DelaySource, Interval)> {
        let (source, offset) = ClockClaim::offset(self.edge.as_ref()?, self.cloud.as_ref()?);
        let drift = Span::from_nanos(limit.max_change_between(self.at.nanos(), at.nanos()));
        Some((source, Interval { lo: offset.lo - drift, hi: offset.hi + drift }))
    }
}

/// Intervals of the offset at one time, by source.
#[derive(Clone, Debug)]
pub(super) struct OffsetSources {
    /// The bounds that the exchanges prove (the band), and the estimate within these bounds.
    pub(super) band_offset: Option<(Interval, Span)>,
    /// `true` if some offset agrees with all exchanges, the limit of drift and the limit of the drift's change.
    pub(super) is_consistent: bool,
    /// The proof that both hosts read the same clock, or the claims of both hosts' time daemons together.
    pub(super) proof_or_claims: Option<(DelaySource, Interval)>,
}

/// The offset at one time that follows from all sources together.
#[derive(Clone, Copy, Debug)]
pub(super) struct CombinedOffset {
    pub(super) bounds: Interval,
    /// Estimate within the bounds.
    pub(super) estimate: Span,
    pub(super) source: DelaySource,
    /// `true` if the sources overlap and the exchanges agree. If the sources do not overlap, `bounds` contains the
    /// intervals of all sources, and `estimate` is the estimate of the band.
    pub(super) is_consistent: bool,
}

impl OffsetSources {
    /// Returns each source with its interval, the band first.
    pub(super) fn sources(&self) -> Vec<(DelaySource, Interval)> {
        self.band_offset
            .map(|(band, _)| (DelaySource::InBand, band))
            .into_iter()
            .chain(self.proof_or_claims)
            .collect()
    }

    /// Returns the combination of the sources; `None` if there is no source.
    pub(super) fn combine(&self) -> Option<CombinedOffset> {
        let combined = self.intersect()?;
        Some(CombinedOffset { is_consistent: combined.is_consistent && self.is_consistent, ..combined })
    }

    /// Returns the intersection of the sources, or their hull if they do not overlap.
    fn intersect(&self) -> Option<CombinedOffset> {
        let ((band, estimate), (source, other)) = match (self.band_offset, self.proof_or_claims) {
            (None, None) => return None,
            (Some((bounds, estimate)), None) => {
                return Some(CombinedOffset {
                    bounds,
                    estimate,
                    source: DelaySource::InBand,
                    is_consistent: true,
                });
            }
            (None, Some((source, bounds))) => {
                return Some(CombinedOffset {
                    bounds,
                    estimate: bounds.middle(),
                    source,
                    is_consistent: true,
                });
            }
            (Some(band_offset), Some(other)) => (band_offset, other),
        };
        let Some(bounds) = band.intersection(other) else {
            // Averaging the sources would hide that one of them is wrong.
            let bounds = band.hull(other);
            return Some(CombinedOffset {
                bounds,
                estimate,
                source: DelaySource::InBand,
                is_consistent: false,
            });
        };
        // If the band is as narrow as the proof that both hosts read one clock, the proof is the source: a delay is
        // then the exact difference of the stamps.
        let source = if source != DelaySource::SameClock && bounds == band {
            DelaySource::InBand
        } else if bounds == other {
            source
        } else {
            DelaySource::Intersection
        };
        // The band's estimate assumes a symmetric path. If it lies outside of the other source, the path is asymmetric,
        // and the middle of the overlap is the best estimate.
        let estimate = if bounds.contains(estimate) { estimate } else { bounds.middle() };
        Some(CombinedOffset { bounds, estimate, source, is_consistent: true })
    }
}
