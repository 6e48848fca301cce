//! What is known of the offset between two hosts' clocks: from the exchanges between them, from what their time
//! daemons claim, and from their identities.

mod judging;
mod presence;
mod sources;
mod steps;
mod suspects;
#[cfg(test)]
mod tests;
mod types;

use crate::band::{Band, Bounds, DriftLimit};
use crate::{ClockIdentity, Discipline, Exchange, RawTime, RelatedClocks, Span, WallTime, Witnessed};
use presence::Presence;
use sources::Claims;
use steps::StepTracker;
use suspects::Contradictions;
pub use types::{Direction, ExchangeCounts, Judged, Learned, Offset, Refusal, RelationSettings};

/// Offsets and stamps beyond are no clock's (±73 years; a host without a battery starts in 1970).
const ABSURD: Span = Span::from_nanos(1 << 61);
/// A wall clock that moved on differently from the monotonic one by more was stepped: two reads of two clocks, and
/// what a rehearsed clock drifts.
const STEADY: Span = Span::from_micros(50);
const STEADY_PPM: i64 = 500;

/// The relation between a clock of an edge and one of a cloud; it belongs to the pair of hosts, fed by all their links.
///
/// How it works, in words: `docs/clocks.md`.
#[derive(Debug)]
pub struct Relation {
    same_clock: bool,
    settings: RelationSettings,
    drift: DriftLimit,
    band: Band,
    presence: Presence,
    contradictions: Contradictions,
    steps: StepTracker,
    /// The band was begun by a step and took nothing yet; with the last estimate before.
    restarted: Option<Option<Span>>,
    claims: Claims,
    counts: ExchangeCounts,
}

impl Relation {
    /// What two identities alone tell, ready to learn more.
    pub fn new(edge: &ClockIdentity, cloud: &ClockIdentity, settings: RelationSettings) -> Self {
        let drift = DriftLimit::new(settings.max_drift_ppm);
        Self {
            // The wall clock of a host is not its free-running clock.
            same_clock: edge == cloud && settings.clocks != RelatedClocks::RawToWall,
            settings,
            drift,
            band: Band::new(drift, settings.window, settings.retention),
            presence: Presence::new(settings.fresh, settings.window.max(settings.retention)),
            contradictions: Contradictions::default(),
            steps: StepTracker::default(),
            restarted: None,
            claims: Claims::default(),
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

    /// What the two hosts' time daemons say now; `None` for one that says nothing. A claim counts, where the settings trust it,
    /// until the next call, or until the clock it is about is stepped.
    pub fn set_disciplines(&mut self, edge: Option<Discipline>, cloud: Option<Discipline>) {
        self.claims = Claims { edge, cloud };
    }

    /// The offset at a time of the edge's clock within the window or shortly after, when its wall clock showed `wall`; `None` when
    /// nothing is known.
    pub fn offset(&self, at: RawTime, wall: WallTime) -> Option<Offset> {
        let known = self.knowledge(at, None);
        let combined = known.combined()?;
        let fresh = self.presence.near(at, at, self.settings.fresh);
        Some(Offset {
            at: wall,
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
        self.band.newest().is_some_and(|newest| self.contradictions.surprises.cast_doubt(newest))
    }

    /// Bytes of memory that the exchanges of the window take.
    pub fn memory_bytes(&self) -> usize {
        self.band.memory_bytes() + self.contradictions.suspects.memory_bytes() + self.presence.memory_bytes()
    }

    /// An exchange of probes finished.
    pub fn learn(&mut self, witnessed: &Witnessed) -> Learned {
        let learned = self.consider(witnessed);
        let counts = &mut self.counts;
        match learned {
            Learned::Taken | Learned::Restarted(_) => {
                counts.taken += 1;
                self.presence.note(witnessed.exchange.returned);
            }
            Learned::Refused(Refusal::Impossible) => counts.impossible += 1,
            Learned::Refused(Refusal::Outlier) => counts.outliers += 1,
            Learned::Refused(Refusal::Stepped) => counts.stepped += 1,
        }
        learned
    }

    /// The host's own clock was stepped, or ran off faster than the limit: what was learnt before is void.
    pub fn edge_stepped(&mut self, epoch: u32) {
        if self.steps.edge_stepped(epoch) {
            self.claims.edge = None;
            self.restart();
        }
    }

    /// The peer says that its clock was.
    pub fn cloud_stepped(&mut self, epoch: u32) {
        if self.steps.cloud_stepped(epoch) {
            self.claims.cloud = None;
            self.restart();
        }
    }

    fn consider(&mut self, witnessed: &Witnessed) -> Learned {
        let exchange = &witnessed.exchange;
        if !self.is_possible(exchange) {
            return Learned::Refused(Refusal::Impossible);
        }
        // An exchange that spans a step does not count, but its counters do.
        let report = self.steps.compare(witnessed);
        self.claims.edge.take_if(|_| report.of_edge);
        self.claims.cloud.take_if(|_| report.of_cloud);
        if report.of_edge || report.of_cloud {
            self.restart();
        }
        if !report.is_current || !is_steady(witnessed) || self.steps.excludes(exchange) {
            return Learned::Refused(Refusal::Stepped);
        }
        let bounds = Bounds::from(exchange);
        if self.band.excludes(&bounds) {
            let empty = || Band::new(self.drift, self.settings.window, self.settings.retention);
            let Some(believed) = self.contradictions.suspects.add(&bounds, empty) else {
                return Learned::Refused(Refusal::Outlier);
            };
            self.steps.admit_all();
            self.restart();
            self.contradictions.surprises.note(exchange.returned);
            self.band = believed;
        } else {
            self.contradictions.suspects.hear(&bounds);
            self.band.insert(&bounds);
        }
        match self.restarted.take() {
            None => Learned::Taken,
            Some(before) => {
                let now = self.estimate_at(exchange.returned);
                Learned::Restarted(before.zip(now).map(|(before, now)| now - before))
            }
        }
    }

    /// Whether any two clocks can show this: an answer after the message, and a round trip that is not negative, by more
    /// than the stamps are wrong and than the clocks can run apart meanwhile.
    fn is_possible(&self, exchange: &Exchange) -> bool {
        let Exchange { sent, received, replied, returned, uncertainty } = *exchange;
        let apart = Span::from_nanos(self.drift.between(sent.nanos(), returned.nanos()));
        let absurd = [sent, received, replied, returned]
            .into_iter()
            .map(|stamp| stamp - RawTime::from_nanos(0))
            .chain([exchange.upper(), exchange.lower(), uncertainty])
            .any(|span| span.abs() > ABSURD);
        !absurd
            && !uncertainty.is_negative()
            && returned >= sent
            && replied >= received
            && exchange.round_trip() + uncertainty + uncertainty + apart >= Span::ZERO
    }

    /// Begins a new window after a step of a clock.
    fn restart(&mut self) {
        self.contradictions.suspects.clear();
        let Some(newest) = self.band.newest() else { return };
        self.restarted = Some(self.estimate_at(newest));
        self.band = Band::new(self.drift, self.settings.window, self.settings.retention);
        self.presence.clear();
        self.counts.restarts += 1;
    }

    fn estimate_at(&self, at: RawTime) -> Option<Span> {
        self.band.interval(at).map(|interval| self.band.estimate(at, interval))
    }
}

/// Whether each wall clock moved on like its monotonic clock.
fn is_steady(witnessed: &Witnessed) -> bool {
    let Exchange { sent, received, replied, returned, .. } = witnessed.exchange;
    let alike = |wall: Span, mono: Option<Span>| {
        mono.is_none_or(|mono| {
            let limit = STEADY + Span::from_nanos(mono.abs().nanos() / 1_000_000 * STEADY_PPM);
            (wall - mono).abs() <= limit
        })
    };
    alike(returned - sent, witnessed.edge_elapsed) && alike(replied - received, witnessed.cloud_elapsed)
}
