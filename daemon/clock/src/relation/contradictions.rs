//! Exchanges that contradict the current band: either their stamps are wrong, or they are the first exchanges after an
//! unannounced step: a step that no host reported.

use super::types::ViolatedLimit;
use crate::band::{Band, Bounds, Contradiction};
use crate::{RawTime, Span};

/// Number of agreeing suspects that prove an unannounced step.
// A single wrong stamp must not discard the current band.
const MIN_SUSPECTS_FOR_STEP: u64 = 4;

/// Two unannounced steps within this time show that a limit is violated. From the second step on, the limit counts as
/// violated for the same time.
// Clocks are rarely set twice a minute. A clock that drifts faster than the limit, or a peer that sends wrong stamps,
// contradicts the current band again and again.
const VIOLATION_DURATION: Span = Span::from_seconds(60);

/// Exchanges that contradict the current band, and the unannounced steps that earlier exchanges proved.
#[derive(Clone, Debug, Default)]
pub(super) struct Contradictions {
    pub(super) suspects: SuspectExchanges,
    pub(super) unannounced_steps: UnannouncedSteps,
}

/// The last unannounced step, and the limit that several such steps violate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UnannouncedSteps {
    /// Time of the last step, and the contradiction that showed it.
    last_step: Option<(RawTime, Contradiction)>,
    /// Time until which a limit counts as violated, and the limit.
    violated_limit: Option<(RawTime, ViolatedLimit)>,
}

impl UnannouncedSteps {
    /// Records a step. A second step within [`VIOLATION_DURATION`] violates a limit.
    pub(super) fn record(&mut self, at: RawTime, contradiction: Contradiction) {
        if let Some((_, previous)) =
            self.last_step.filter(|(time, _)| (at - *time).abs() <= VIOLATION_DURATION)
        {
            // The limit of drift counts as violated only if both steps contradict it.
            let is_drift_change = [previous, contradiction].contains(&Contradiction::DriftChange);
            let limit = if is_drift_change { ViolatedLimit::DriftChange } else { ViolatedLimit::Drift };
            self.violated_limit = Some((at + VIOLATION_DURATION, limit));
        }
        self.last_step = Some((at, contradiction));
    }

    /// Returns the limit that counts as violated at a time; `None` if there is none.
    pub(super) fn violated_limit(&self, at: RawTime) -> Option<ViolatedLimit> {
        // If the edge's clock was set back by more than `VIOLATION_DURATION`, the end of the violation lies far in the
        // future. The violation then counts as over.
        self.violated_limit
            .filter(|(end, _)| at < *end && *end - at <= VIOLATION_DURATION + VIOLATION_DURATION)
            .map(|(_, limit)| limit)
    }
}

/// Exchanges that contradict the current band, agree with each other, and were not refuted by a later exchange.
#[derive(Clone, Debug, Default)]
pub(super) struct SuspectExchanges {
    /// Band of the suspects; `None` without suspects.
    band: Option<Band>,
    /// Bounds of each suspect; without meaning while `band` is `None`. An answer that arrives twice counts once.
    bounds: Vec<Bounds>,
}

impl SuspectExchanges {
    /// Adds an exchange that contradicts the current band. If the exchange contradicts the earlier suspects, the
    /// exchange replaces them. Once the suspects prove a step, returns the band of all suspects, and the time at which
    /// the first of them was sent.
    pub(super) fn add(
        &mut self,
        bounds: &Bounds,
        new_band: impl FnOnce() -> Band,
    ) -> Option<(Band, RawTime)> {
        let mut band = match self.band.take().filter(|band| band.contradiction(bounds).is_none()) {
            Some(band) => band,
            None => {
                self.bounds.clear();
                new_band()
            }
        };
        if !self.bounds.iter().any(|suspect| suspect.sent() == bounds.sent()) {
            self.bounds.push(*bounds);
            band.insert(bounds);
        }
        if band.exchange_count() >= MIN_SUSPECTS_FOR_STEP {
            let first_sent = self.bounds.iter().map(Bounds::sent).min()?;
            return Some((band, first_sent));
        }
        self.band = Some(band);
        None
    }

    /// Compares the suspects with an accepted exchange, which the current band already contains. Removes the suspects if
    /// - the exchange contradicts the suspects,
    /// - the suspects contradict no exchange that still bounds the offset, or
    /// - the suspects are too old to bound the offset themselves.
    // The suspects stay if the exchange has such wide bounds that it fits the band of the suspects, too. If they were
    // removed, no step could be recognised under load. The suspicion still ends: if the clocks changed, the exchanges
    // from before the change leave the window at some time. The method is `cold`, because suspects are rare, but `learn`
    // is called for every message.
    #[cold]
    pub(super) fn reconsider(&mut self, exchange: &Bounds, current: &Band) {
        let start = current.window_start(exchange.sent());
        let bounding = current.without_exchanges_before(start);
        let still_contradicts =
            |suspect: &Bounds| suspect.sent() >= start && bounding.contradiction(suspect).is_some();
        let is_contradicted = |band: &Band| band.contradiction(exchange).is_some();
        if self.band.as_ref().is_some_and(is_contradicted) || !self.bounds.iter().any(still_contradicts) {
            self.band = None;
        }
    }

    /// Returns whether there are no suspects.
    pub(super) fn is_empty(&self) -> bool {
        self.band.is_none()
    }

    /// Removes all suspects.
    pub(super) fn clear(&mut self) {
        self.band = None;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.band.as_ref().map_or(0, Band::memory_bytes) + self.bounds.capacity() * size_of::<Bounds>()
    }
}
