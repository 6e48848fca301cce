//! The relation between two hosts' clocks: its offset by the exchanges between the hosts, by the claims of their time
//! daemons, and by a proof that they read one clock.
//!
//! No I/O: tests feed generated histories of clocks and paths, some of which violate an assumption.

mod judging;
mod jumps;
mod presence;
mod sources;
mod steps;
mod suspects;
#[cfg(test)]
mod tests;
mod types;
mod windows;

use crate::band::{Bounds, Contradiction, ProvenSkew};
use crate::{Discipline, Exchange, ExchangeObservation, RawTime, RelatedClocks, Span, WallTime};
use presence::Presence;
use sources::Claims;
use steps::StepTracker;
use suspects::Contradictions;
pub use types::{
    Direction, Doubt, ExchangeCounts, JudgedExchange, LearnResult, Offset, Refusal, RelationSettings,
};
use windows::Windows;

/// Largest magnitude of stamps and offsets (±73 years; a host without a battery starts in 1970).
const ABSURD: Span = Span::from_nanos(1 << 61);
/// Largest difference between the progress of a wall clock and of the monotonic clock that is no step: the time to read
/// two clocks, plus [`STEADY_PPM`] for the drift of a clock with injected faults.
const STEADY: Span = Span::from_micros(50);
const STEADY_PPM: i64 = 500;

/// The relation between a clock of an edge and one of a cloud. It belongs to the pair of hosts; all their links
/// contribute exchanges.
///
/// `docs/clocks.md` explains the method.
#[derive(Debug)]
pub struct Relation {
    same_clock: bool,
    settings: RelationSettings,
    windows: Windows,
    presence: Presence,
    contradictions: Contradictions,
    steps: StepTracker,
    /// Set if a step began the window and no exchange was accepted since; contains the last estimate before the step.
    restarted: Option<Option<Span>>,
    claims: Claims,
    counts: ExchangeCounts,
}

impl Relation {
    /// Creates a relation without exchanges.
    pub fn new(settings: RelationSettings) -> Self {
        Self {
            same_clock: false,
            settings,
            windows: Windows::new(&settings),
            presence: Presence::new(settings.fresh, settings.window.max(settings.retention)),
            contradictions: Contradictions::default(),
            steps: StepTracker::default(),
            restarted: None,
            claims: Claims::default(),
            counts: ExchangeCounts::default(),
        }
    }

    /// Returns whether both hosts read one clock, so that the offset is exactly zero.
    pub const fn is_same_clock(&self) -> bool {
        self.same_clock
    }

    /// Sets whether it is proven that both processes read one clock. Exchanges are learnt in either case: they check
    /// the proof, and bound the offset after it ends.
    pub fn set_same_clock(&mut self, is_proven: bool) {
        // A host's wall clock and its free-running clock are different clocks.
        self.same_clock = is_proven && self.settings.clocks != RelatedClocks::RawToWall;
    }

    /// Returns the settings of the relation.
    pub const fn settings(&self) -> &RelationSettings {
        &self.settings
    }

    /// Sets the current claims of the two hosts' time daemons; `None` for a host without a claim. A claim counts, if
    /// the settings trust it, until the next call or until its clock is stepped.
    pub fn set_disciplines(&mut self, edge: Option<Discipline>, cloud: Option<Discipline>) {
        self.claims = Claims { edge, cloud };
    }

    /// Returns the offset at a time of the edge's clock within the window or shortly after it, at which its wall clock
    /// showed `wall`; `None` if nothing is known.
    pub fn offset(&self, at: RawTime, wall: WallTime) -> Option<Offset> {
        let known = self.knowledge(at, None);
        let combined = known.combined()?;
        let band = self.windows.current();
        let fresh = self.presence.near(at, at, self.settings.fresh);
        Some(Offset {
            at: wall,
            estimate: combined.estimate,
            bounds: combined.bounds,
            source: combined.source,
            sources: known.sources(),
            verdict: self.verdict_of(&combined, fresh),
            skew_ppm: band.skew_ppm(),
            exchanges: band.exchanges(),
            age: band.newest().map(|newest| (at - newest).max(Span::ZERO)),
        })
    }

    /// Returns the numbers of accepted and refused exchanges.
    pub const fn counts(&self) -> ExchangeCounts {
        self.counts
    }

    /// Returns the number of the window: it grows when a step invalidates what was learnt before, and when a jump is
    /// suspected.
    pub const fn window(&self) -> u32 {
        self.counts.restarts
    }

    /// Returns the skew that the exchanges of the current window prove whatever the delays were; `None` without enough
    /// exchanges.
    pub fn proven_skew(&self) -> Option<ProvenSkew> {
        self.windows.current().proven_skew()
    }

    /// Returns the age of the oldest exchange that bounds the offset at a time: the settings' window, or more where the
    /// newest eight exchanges span a longer time. `None` without exchanges.
    pub fn window_reach(&self, at: RawTime) -> Option<Span> {
        self.windows.current().reach(at)
    }

    /// Returns the assumption that the clocks seem to violate. Delays are `inconsistent` then.
    ///
    /// Exchanges prove a skew beyond the limit, or they contradict each other repeatedly. A peer that sends wrong
    /// stamps has the same effect.
    pub fn doubt(&self) -> Option<Doubt> {
        if self.excess_skew().is_some() {
            return Some(Doubt::Drift);
        }
        self.contradictions.unannounced_steps.doubt(self.windows.current().newest()?)
    }

    /// Returns the proven skew if it is beyond the limit.
    pub fn excess_skew(&self) -> Option<ProvenSkew> {
        self.windows.current().excess_skew()
    }

    /// Returns whether an assumption is in doubt.
    pub fn in_doubt(&self) -> bool {
        self.doubt().is_some()
    }

    /// Returns the bytes of memory that the exchanges of the window take.
    pub fn memory_bytes(&self) -> usize {
        self.windows.memory_bytes()
            + self.contradictions.suspects.memory_bytes()
            + self.presence.memory_bytes()
    }

    /// Learns a finished exchange, unless it is refused.
    pub fn learn(&mut self, observation: &ExchangeObservation) -> LearnResult {
        let learned = self.consider(observation);
        let counts = &mut self.counts;
        match learned {
            LearnResult::Taken | LearnResult::Restarted(_) | LearnResult::Jumped(_) => {
                counts.taken += 1;
                self.presence.note(observation.exchange.returned);
            }
            LearnResult::Refused(Refusal::Impossible) => counts.impossible += 1,
            LearnResult::Refused(Refusal::Outlier) => counts.outliers += 1,
            LearnResult::Refused(Refusal::Stepped) => counts.stepped += 1,
        }
        learned
    }

    /// Begins a new window after a step of the edge's own clock, or after a drift beyond the limit.
    pub fn edge_stepped(&mut self, epoch: u32) {
        if self.steps.edge_stepped(epoch) {
            self.claims.edge = None;
            self.restart();
        }
    }

    /// Begins a new window after the peer reported a step of its clock, or a drift beyond the limit.
    pub fn cloud_stepped(&mut self, epoch: u32) {
        if self.steps.cloud_stepped(epoch) {
            self.claims.cloud = None;
            self.restart();
        }
    }

    fn consider(&mut self, observation: &ExchangeObservation) -> LearnResult {
        let exchange = &observation.exchange;
        if !self.is_possible(exchange) {
            return LearnResult::Refused(Refusal::Impossible);
        }
        // An exchange that spans a step is refused, but its epochs count.
        let report = self.steps.compare(observation);
        self.claims.edge.take_if(|_| report.of_edge);
        self.claims.cloud.take_if(|_| report.of_cloud);
        if report.of_edge || report.of_cloud {
            self.restart();
        }
        if !report.is_current || !is_steady(observation) || self.steps.excludes(exchange) {
            return LearnResult::Refused(Refusal::Stepped);
        }
        let bounds = Bounds::from(exchange);
        let contradiction = self.windows.contradiction(&bounds);
        let moved = match contradiction {
            Some(contradiction) => {
                if !self.replace_window(&bounds, exchange.returned, contradiction) {
                    return LearnResult::Refused(Refusal::Outlier);
                }
                None
            }
            None => {
                let moved = self.windows.insert(exchange, &bounds);
                let suspects = &mut self.contradictions.suspects;
                if !suspects.is_empty() {
                    suspects.reconsider(&bounds, self.windows.current());
                }
                moved
            }
        };
        if let Some(moved) = moved {
            self.contradictions.suspects.clear();
            self.counts.restarts += 1;
            return LearnResult::Jumped(moved);
        }
        match self.restarted.take() {
            None => LearnResult::Taken,
            Some(before) => {
                let now = self.estimate_at(exchange.returned);
                LearnResult::Restarted(before.zip(now).map(|(before, now)| now - before))
            }
        }
    }

    /// Adds an exchange that contradicts the window to the suspects. Returns whether enough suspects agree, in which
    /// case they replace the window.
    fn replace_window(&mut self, bounds: &Bounds, at: RawTime, contradiction: Contradiction) -> bool {
        let Some(window) = self.contradictions.suspects.add(bounds, || self.windows.empty()) else {
            return false;
        };
        self.steps.admit_all();
        self.restart();
        self.contradictions.unannounced_steps.record(at, contradiction);
        self.windows.restart(window);
        true
    }

    /// Returns whether two clocks can produce these stamps: the answer follows the message, and the round trip is not
    /// negative by more than the stamps' uncertainty and the clocks' drift.
    fn is_possible(&self, exchange: &Exchange) -> bool {
        let Exchange { sent, received, replied, returned, uncertainty } = *exchange;
        let apart = Span::from_nanos(self.windows.limit().between(sent.nanos(), returned.nanos()));
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
        let Some(newest) = self.windows.current().newest() else { return };
        self.restarted = Some(self.estimate_at(newest));
        self.windows.restart(self.windows.empty());
        self.presence.clear();
        self.counts.restarts += 1;
    }

    fn estimate_at(&self, at: RawTime) -> Option<Span> {
        self.windows.interval(at).map(|known| self.windows.estimate(at, known))
    }
}

/// Returns whether the cloud's clock advanced like its monotonic clock, where both are known.
fn is_steady(ExchangeObservation { exchange, cloud_elapsed, .. }: &ExchangeObservation) -> bool {
    cloud_elapsed.is_none_or(|mono| {
        let limit = STEADY + Span::from_nanos(mono.abs().nanos() / 1_000_000 * STEADY_PPM);
        (exchange.replied - exchange.received - mono).abs() <= limit
    })
}
