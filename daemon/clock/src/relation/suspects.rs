//! Exchanges that contradict the band: errors and lies, or the first after a step that nobody announced.

use super::types::Doubt;
use crate::band::{Band, Bounds, Contradiction};
use crate::{RawTime, Span};

/// So many in a row that agree with each other are believed.
const BELIEVED: u64 = 4;

/// A clock that is set twice within such a time, and both times without notice, is not set: it drifts faster than the
/// limit, or somebody lies. Nothing is believed for as long after the last time.
const DOUBT: Span = Span::from_seconds(60);

/// What contradicts the band now, and how often a window began because of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Contradictions {
    pub(super) suspects: Suspects,
    pub(super) surprises: Surprises,
}

/// When windows began without notice.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Surprises {
    last: Option<(RawTime, Contradiction)>,
    doubt: Option<(RawTime, Doubt)>,
}

impl Surprises {
    /// One more.
    pub(super) fn note(&mut self, at: RawTime, contradiction: Contradiction) {
        if let Some((_, before)) = self.last.filter(|(last, _)| (at - *last).abs() <= DOUBT) {
            let is_change = [before, contradiction].contains(&Contradiction::DriftChange);
            let doubt = if is_change { Doubt::DriftChange } else { Doubt::Drift };
            self.doubt = Some((at + DOUBT, doubt));
        }
        self.last = Some((at, contradiction));
    }

    /// What there is to doubt at a time because of too many of them before.
    pub(super) fn doubt(&self, at: RawTime) -> Option<Doubt> {
        // A clock that is set back by more than the doubt lasts must not be doubted until it is there again.
        self.doubt.filter(|(until, _)| at < *until && *until - at <= DOUBT + DOUBT).map(|(_, doubt)| doubt)
    }
}

/// Contradicting exchanges that agree with each other, with nothing against them since.
#[derive(Clone, Debug, Default)]
pub(super) struct Suspects {
    band: Option<Band>,
    /// When they were sent: an answer that came several times is one.
    sent: Vec<RawTime>,
}

impl Suspects {
    /// One more that contradicts. Returns the band of all of them when there are enough: a clock was stepped.
    pub(super) fn add(&mut self, bounds: &Bounds, empty: impl FnOnce() -> Band) -> Option<Band> {
        let mut band = match self.band.take().filter(|band| band.contradiction(bounds).is_none()) {
            Some(band) => band,
            None => {
                self.sent.clear();
                empty()
            }
        };
        if !self.sent.contains(&bounds.sent()) {
            self.sent.push(bounds.sent());
            band.insert(bounds);
        }
        if band.exchanges() >= BELIEVED {
            return Some(band);
        }
        self.band = Some(band);
        None
    }

    /// One that fits the band. If it does not fit the suspects as well, they were wrong. A wide one that fits both says
    /// nothing, or a step under load would never be believed.
    pub(super) fn hear(&mut self, bounds: &Bounds) {
        self.band = self.band.take().filter(|band| band.contradiction(bounds).is_none());
    }

    /// Whether there are any, so that the band is in doubt.
    pub(super) fn any(&self) -> bool {
        self.band.is_some()
    }

    pub(super) fn clear(&mut self) {
        self.band = None;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.band.as_ref().map_or(0, Band::memory_bytes)
    }
}
