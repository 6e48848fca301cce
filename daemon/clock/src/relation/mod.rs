//! What is known of the offset between two hosts' wall clocks: from the exchanges between them, from what their time
//! daemons claim, and from their identities.

mod judging;
mod learning;
mod presence;
mod sources;
mod suspects;
#[cfg(test)]
mod tests;
mod types;

use crate::band::{Band, DriftLimit};
use crate::{ClockIdentity, DelaySource, Discipline, Interval, Span, WallTime};
use learning::{Barrier, Epochs};
use presence::Presence;
use suspects::{Surprises, Suspects};
pub use types::{Direction, ExchangeCounts, Judged, Learned, Offset, Refusal, RelationSettings};

/// The relation between the wall clocks of an edge and a cloud; it belongs to the pair of hosts, fed by all
/// their links.
///
/// How it works, in words: `docs/clocks.md`.
#[derive(Debug)]
pub struct Relation {
    same_clock: bool,
    settings: RelationSettings,
    drift: DriftLimit,
    band: Band,
    presence: Presence,
    suspects: Suspects,
    surprises: Surprises,
    epochs: Epochs,
    barrier: Barrier,
    /// The band was begun by a step and took nothing yet; with the last estimate before.
    restarted: Option<Option<Span>>,
    edge: Option<Discipline>,
    cloud: Option<Discipline>,
    counts: ExchangeCounts,
}

impl Relation {
    /// What two identities alone tell, ready to learn more.
    pub fn new(edge: &ClockIdentity, cloud: &ClockIdentity, settings: RelationSettings) -> Self {
        let drift = DriftLimit::new(settings.max_drift_ppm);
        Self {
            same_clock: edge == cloud,
            settings,
            drift,
            band: Band::new(drift, settings.window),
            presence: Presence::new(settings.fresh, settings.window),
            suspects: Suspects::default(),
            surprises: Surprises::default(),
            epochs: Epochs::default(),
            barrier: Barrier::Open,
            restarted: None,
            edge: None,
            cloud: None,
            counts: ExchangeCounts::default(),
        }
    }

    /// Whether both hosts read one clock, so that the offset is exactly zero.
    pub const fn is_same_clock(&self) -> bool {
        self.same_clock
    }

    /// What the estimate rests on.
    pub const fn settings(&self) -> &RelationSettings {
        &self.settings
    }

    /// What the two hosts' time daemons say now; `None` for one that says nothing. A claim counts until the next
    /// call, or until the clock it is about is stepped.
    pub fn set_disciplines(&mut self, edge: Option<Discipline>, cloud: Option<Discipline>) {
        (self.edge, self.cloud) = (edge, cloud);
    }

    /// The offset at a time of the edge's wall clock within the window or shortly after; `None` when nothing is
    /// known.
    pub fn offset(&self, at: WallTime) -> Option<Offset> {
        let known = self.knowledge(at, None);
        let combined = known.combined()?;
        let fresh = self.presence.near(at, at, self.settings.fresh);
        Some(Offset {
            at,
            estimate: combined.estimate,
            bounds: combined.bounds,
            source: combined.source,
            sources: known.sources(),
            verdict: self.verdict_of(&combined, fresh),
            skew_ppm: self.band.skew_ppm(),
            exchanges: self.band.exchanges(),
            age: self.band.newest().map(|newest| (at - newest).max(Span::ZERO)),
        })
    }

    /// What became of the exchanges.
    pub const fn counts(&self) -> ExchangeCounts {
        self.counts
    }

    /// Which window this is: grows whenever a step makes void what was learnt before.
    pub const fn window(&self) -> u32 {
        self.counts.restarts
    }

    /// Whether exchanges contradict each other again and again: the clocks drift apart faster than the limit, or a peer
    /// lies. Delays are `inconsistent` then.
    pub fn in_doubt(&self) -> bool {
        self.band.newest().is_some_and(|newest| self.surprises.cast_doubt(newest))
    }

    /// Bytes of memory that the exchanges of the window take.
    pub fn memory_bytes(&self) -> usize {
        self.band.memory_bytes() + self.suspects.memory_bytes() + self.presence.memory_bytes()
    }

    fn discipline(&self) -> Option<(DelaySource, Interval)> {
        let (edge, cloud) = (self.edge.as_ref()?, self.cloud.as_ref()?);
        let chrony = [edge, cloud].iter().any(|claim| claim.source == DelaySource::Chrony);
        let source = if chrony { DelaySource::Chrony } else { edge.source };
        Some((source, Discipline::offset(edge, cloud)))
    }
}
