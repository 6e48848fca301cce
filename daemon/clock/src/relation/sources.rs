//! Several sources, one answer: the intersection of what they say (RFC 5905, section 11.2.1, after Marzullo 1984; with two
//! sources that must both be right it is their overlap, and without one they are reported, not averaged).

use crate::{DelaySource, Discipline, Interval, Span};

/// What the two hosts' time daemons say now.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims {
    pub(super) edge: Option<Discipline>,
    pub(super) cloud: Option<Discipline>,
}

impl Claims {
    /// Returns the offset by both claims together, unless one is missing.
    pub(super) fn offset(&self) -> Option<(DelaySource, Interval)> {
        Some(Discipline::offset(self.edge.as_ref()?, self.cloud.as_ref()?))
    }
}

/// What each source says of the offset at one time.
#[derive(Clone, Debug)]
pub(super) struct Knowledge {
    /// The band and the estimate within.
    pub(super) in_band: Option<(Interval, Span)>,
    /// Whether the exchanges have an offset in common that keeps all assumptions.
    pub(super) is_consistent: bool,
    /// A proof of one clock, or both hosts' time daemons together.
    pub(super) other: Option<(DelaySource, Interval)>,
}

/// The answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Combined {
    pub(super) bounds: Interval,
    /// Within the bounds.
    pub(super) estimate: Span,
    pub(super) source: DelaySource,
    /// Whether the sources have anything in common. If not, the bounds hold them all, and the estimate is the band's
    /// own: between the two lies nothing that anyone claims.
    pub(super) agree: bool,
}

impl Knowledge {
    pub(super) fn sources(&self) -> Vec<(DelaySource, Interval)> {
        self.in_band.map(|(band, _)| (DelaySource::InBand, band)).into_iter().chain(self.other).collect()
    }

    /// `None` when there is no source.
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
        // An estimate outside the other source is off by an asymmetry that nothing else shows: the middle is then the
        // best that can be said.
        let estimate = if bounds.contains(estimate) { estimate } else { bounds.middle() };
        Some(Combined { bounds, estimate, source, agree: true })
    }
}
