//! Combination of several sources by intersection (RFC 5905, section 11.2.1, after Marzullo 1984).
//!
//! With two sources that must both be right, the intersection is their overlap. Without an overlap the contradiction is
//! reported; the sources are not averaged.

use crate::{DelaySource, Discipline, Interval, Span};

/// Current claims of the two hosts' time daemons.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims {
    pub(super) edge: Option<Discipline>,
    pub(super) cloud: Option<Discipline>,
}

impl Claims {
    /// Returns the offset by both claims together; `None` if one is missing.
    pub(super) fn offset(&self) -> Option<(DelaySource, Interval)> {
        Some(Discipline::offset(self.edge.as_ref()?, self.cloud.as_ref()?))
    }
}

/// Statements of all sources about the offset at one time.
#[derive(Clone, Debug)]
pub(super) struct Knowledge {
    /// The band and the estimate within it.
    pub(super) in_band: Option<(Interval, Span)>,
    /// `true` if some offset agrees with all exchanges and both assumptions.
    pub(super) is_consistent: bool,
    /// A proof of one clock, or the claims of both hosts' time daemons together.
    pub(super) other: Option<(DelaySource, Interval)>,
}

/// The combined statement about the offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Combined {
    pub(super) bounds: Interval,
    /// Estimate within the bounds.
    pub(super) estimate: Span,
    pub(super) source: DelaySource,
    /// `true` if the sources overlap. If not, the bounds contain them all, and the estimate is the band's, because no
    /// source claims a value between the two.
    pub(super) agree: bool,
}

impl Knowledge {
    pub(super) fn sources(&self) -> Vec<(DelaySource, Interval)> {
        self.in_band.map(|(band, _)| (DelaySource::InBand, band)).into_iter().chain(self.other).collect()
    }

    /// Returns the combination of the sources; `None` if there is no source.
    pub(super) fn combined(&self) -> Option<Combined> {
        let combined = self.intersected()?;
        Some(Combined { agree: combined.agree && self.is_consistent, ..combined })
    }

    fn intersected(&self) -> Option<Combined> {
        let ((band, estimate), (source, other)) = match (self.in_band, self.other) {
            (None, None) => return None,
            (Some((bounds, estimate)), None) => {
                return Some(Combined { bounds, estimate, source: DelaySource::InBand, agree: true });
            }
            (None, Some((source, bounds))) => {
                return Some(Combined { bounds, estimate: bounds.middle(), source, agree: true });
            }
            (Some(in_band), Some(other)) => (in_band, other),
        };
        let Some(bounds) = band.intersection(other) else {
            // Without an overlap at least one source is wrong; averaging them would hide that.
            let bounds = band.hull(other);
            return Some(Combined { bounds, estimate, source: DelaySource::InBand, agree: false });
        };
        let source = if source != DelaySource::SameClock && bounds == band {
            DelaySource::InBand
        } else if bounds == other {
            source
        } else {
            DelaySource::Intersection
        };
        // An estimate outside the other source is wrong by an asymmetry of the path that nothing else shows. The middle
        // of the overlap is then the best estimate.
        let estimate = if bounds.contains(estimate) { estimate } else { bounds.middle() };
        Some(Combined { bounds, estimate, source, agree: true })
    }
}
