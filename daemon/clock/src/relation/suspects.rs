//! Exchanges that contradict the band: errors and lies, or the first after a step that nobody announced.

use crate::WallTime;
use crate::band::{Band, Bounds};

/// So many in a row that agree with each other are believed.
const BELIEVED: u64 = 4;

/// Contradicting exchanges that agree with each other, with nothing against them since.
#[derive(Clone, Debug, Default)]
pub(super) struct Suspects {
    band: Option<Band>,
    /// When they were sent: an answer that came several times is one.
    sent: Vec<WallTime>,
}

impl Suspects {
    /// One more that contradicts. Returns the band of all of them when there are enough: a clock was stepped.
    pub(super) fn add(&mut self, bounds: &Bounds, empty: impl FnOnce() -> Band) -> Option<Band> {
        let mut band = match self.band.take().filter(|band| !band.excludes(bounds)) {
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
        self.band = self.band.take().filter(|band| !band.excludes(bounds));
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
