//! What is known of the offset between two hosts' clocks: from the exchanges between them, from what their time
//! daemons claim, and from a proof that they read one clock.

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
pub use types::{Direction, Doubt, ExchangeCounts, Judged, Learned, Offset, Refusal, RelationSettings};
use windows::Windows;

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
    windows: Windows,
    presence: Presence,
    contradictions: Contradictions,
    steps: StepTracker,
    /// The window was begun by a step and took nothing yet; with the last estimate before.
    restarted: Option<Option<Span>>,
    claims: Claims,
    counts: ExchangeCounts,
}

impl Relation {
    /// A relation of which nothing is known yet.
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

    /// Whether both hosts read one clock, so that the offset is exactly zero.
    pub const fn is_same_clock(&self) -> bool {
        self.same_clock
    }

    /// From now on it is proven that both processes read one clock, or it no longer is. Exchanges are learnt in either case: they check
    /// the proof, and bound the offset when it is gone.
    pub fn set_same_clock(&mut self, is_proven: bool) {
        // The wall clock of a host is not its free-running clock.
        self.same_clock = is_proven && self.settings.clocks != RelatedClocks::RawToWall;
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

    /// What became of the exchanges.
    pub const fn counts(&self) -> ExchangeCounts {
        self.counts
    }

    /// Which window this is: grows whenever a step makes void what was learnt before, or a jump is suspected.
    pub const fn window(&self) -> u32 {
        self.counts.restarts
    }

    /// What the exchanges of the current window prove of the skew, whatever the network did; `None` before there are enough.
    pub fn proven_skew(&self) -> Option<ProvenSkew> {
        self.windows.current().proven_skew()
    }

    /// How far the exchanges that bound the offset at a time reach back: the settings' window, or further where exchanges are so rare
    /// that the newest eight take longer. `None` without any.
    pub fn window_reach(&self, at: RawTime) -> Option<Span> {
        self.windows.current().reach(at)
    }

    /// Which assumption the clocks seem not to keep; delays are `inconsistent` then. Exchanges prove a skew beyond the limit, or they
    /// contradict each other again and again; or a peer lies.
    pub fn doubt(&self) -> Option<Doubt> {
        if self.excess_skew().is_some() {
            return Some(Doubt::Drift);
        }
        self.contradictions.unannounced_steps.doubt(self.windows.current().newest()?)
    }

    /// The proven skew, where it is beyond the limit.
    pub fn excess_skew(&self) -> Option<ProvenSkew> {
        self.windows.current().excess_skew()
    }

    /// Whether an assumption is in doubt.
    pub fn in_doubt(&self) -> bool {
        self.doubt().is_some()
    }

    /// Bytes of memory that the exchanges of the window take.
    pub fn memory_bytes(&self) -> usize {
        self.windows.memory_bytes()
            + self.contradictions.suspects.memory_bytes()
            + self.presence.memory_bytes()
    }

    /// Learns a finished exchange, unless it is refused.
    pub fn learn(&mut self, observation: &ExchangeObservation) -> Learned {
        let learned = self.consider(observation);
        let counts = &mut self.counts;
        match learned {
            Learned::Taken | Learned::Restarted(_) | Learned::Jumped(_) => {
                counts.taken += 1;
                self.presence.note(observation.exchange.returned);
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

    /// The peer says that its clock was stepped, or ran faster than the limit.
    pub fn cloud_stepped(&mut self, epoch: u32) {
        if self.steps.cloud_stepped(epoch) {
            self.claims.cloud = None;
            self.restart();
        }
    }

    fn consider(&mut self, observation: &ExchangeObservation) -> Learned {
        let exchange = &observation.exchange;
        if !self.is_possible(exchange) {
            return Learned::Refused(Refusal::Impossible);
        }
        // An exchange that spans a step does not count, but its counters do.
        let report = self.steps.compare(observation);
        self.claims.edge.take_if(|_| report.of_edge);
        self.claims.cloud.take_if(|_| report.of_cloud);
        if report.of_edge || report.of_cloud {
            self.restart();
        }
        if !report.is_current || !is_steady(observation) || self.steps.excludes(exchange) {
            return Learned::Refused(Refusal::Stepped);
        }
        let bounds = Bounds::from(exchange);
        let contradiction = self.windows.contradiction(&bounds);
        let moved = match contradiction {
            Some(contradiction) => {
                if !self.replace_window(&bounds, exchange.returned, contradiction) {
                    return Learned::Refused(Refusal::Outlier);
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
            return Learned::Jumped(moved);
        }
        match self.restarted.take() {
            None => Learned::Taken,
            Some(before) => {
                let now = self.estimate_at(exchange.returned);
                Learned::Restarted(before.zip(now).map(|(before, now)| now - before))
            }
        }
    }

    /// Adds an exchange that contradicts the window to the suspects. Returns whether they replaced the window: enough of them agree.
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

    /// Whether any two clocks can show this: an answer after the message, and a round trip that is not negative, by more
    /// than the stamps are wrong and than the clocks can run apart meanwhile.
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

/// Whether the cloud's clock moved on like its monotonic clock, where both are known.
fn is_steady(ExchangeObservation { exchange, cloud_elapsed, .. }: &ExchangeObservation) -> bool {
    cloud_elapsed.is_none_or(|mono| {
        let limit = STEADY + Span::from_nanos(mono.abs().nanos() / 1_000_000 * STEADY_PPM);
        (exchange.replied - exchange.received - mono).abs() <= limit
    })
}
