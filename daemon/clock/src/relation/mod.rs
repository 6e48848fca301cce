//! The relation between two hosts' clocks: the offset that follows from the exchanges between the hosts, from the
//! claims of their time daemons, and from a proof that both hosts read one clock.
//!
//! The module does no I/O. Tests pass it generated histories of clocks and paths, some of which violate an assumption.

mod bands;
mod contradictions;
mod exchange_times;
mod judging;
mod jumps;
mod sources;
mod steps;
#[cfg(test)]
mod tests;
mod types;

use crate::band::{Bounds, Contradiction, ProvenSkew};
use crate::{ClockClaim, Exchange, ExchangeObservation, RawTime, RelatedClocks, Span, WallTime};
use bands::Bands;
use contradictions::Contradictions;
use exchange_times::ExchangeTimes;
pub use judging::MIN_EXCHANGES_FOR_FRESHNESS;
use sources::Claims;
use steps::StepTracker;
pub use types::{
    Direction, ExchangeCounts, JudgedExchange, LearnResult, Offset, Refusal, RelationSettings, ViolatedLimit,
};

/// Largest magnitude of stamps and offsets: 73 years.
// A host whose clock has no battery starts in 1970, so large offsets are valid.
const MAX_STAMP: Span = Span::from_nanos(1 << 61);
/// Largest difference between the progress of a wall clock and of the monotonic clock that does not count as a step.
// The two clocks are not read at the same moment.
const MAX_READING_DIFFERENCE: Span = Span::from_micros(50);
/// Addition to [`MAX_READING_DIFFERENCE`], in parts per million of the progress.
// A clock with injected faults drifts against the monotonic clock, which is not a step.
const MAX_RATE_DIFFERENCE_PPM: i64 = 500;

/// The relation between a clock of an edge and a clock of a cloud. There is one relation for a pair of hosts, and all
/// links between the two hosts contribute exchanges.
///
/// `docs/clocks.md` explains the method.
#[derive(Debug)]
pub struct Relation {
    same_clock: bool,
    settings: RelationSettings,
    bands: Bands,
    exchange_times: ExchangeTimes,
    contradictions: Contradictions,
    steps: StepTracker,
    /// `Some` from a step until the first exchange after it. The inner value is the last estimate before the step;
    /// `None` if there was no estimate.
    estimate_before_restart: Option<Option<Span>>,
    claims: Claims,
    exchange_counts: ExchangeCounts,
}

impl Relation {
    /// Creates a relation without exchanges.
    pub fn new(settings: RelationSettings) -> Self {
        Self {
            same_clock: false,
            settings,
            bands: Bands::new(&settings),
            exchange_times: ExchangeTimes::new(
                settings.max_fresh_age,
                settings.window.max(settings.retention),
            ),
            contradictions: Contradictions::default(),
            steps: StepTracker::default(),
            estimate_before_restart: None,
            claims: Claims::default(),
            exchange_counts: ExchangeCounts::default(),
        }
    }

    /// Returns whether it is proven that both hosts read one clock. The offset is then exactly zero.
    pub const fn is_same_clock(&self) -> bool {
        self.same_clock
    }

    /// Sets whether it is proven that both hosts read one clock. Exchanges are learnt in either case: they check the
    /// proof, and they bound the offset when the proof no longer holds.
    pub fn set_same_clock(&mut self, is_proven: bool) {
        // `RawToWall` relates a free-running clock to a wall clock. These are different clocks even on one host.
        self.same_clock = is_proven && self.settings.clocks != RelatedClocks::RawToWall;
    }

    /// Returns the settings of the relation.
    pub const fn settings(&self) -> &RelationSettings {
        &self.settings
    }

    /// Sets the claims of the two hosts' time daemons that hold at the time `at` of the edge's clock; `None` for a host
    /// without a claim. A claim is used only if the settings trust time daemons. It counts until the next call or until
    /// its clock is stepped, and at other times than `at` it is wider by the drift in between.
    pub fn set_claims(&mut self, edge: Option<ClockClaim>, cloud: Option<ClockClaim>, at: RawTime) {
        self.claims = Claims { edge, cloud, at };
    }

    /// Returns the offset at the time `at` of the edge's clock, which must lie in the window or shortly after it.
    /// `wall` is the time of the edge's wall clock at the same moment. `None` if no source bounds the offset.
    pub fn offset(&self, at: RawTime, wall: WallTime) -> Option<Offset> {
        // `None`: the band itself gives the estimate.
        let sources = self.offset_sources(at, None);
        let combined = sources.combine()?;
        let band = self.bands.current();
        let is_fresh = self.exchange_times.has_exchange_near(at, at, self.settings.max_fresh_age);
        Some(Offset {
            at: wall,
            estimate: combined.estimate,
            bounds: combined.bounds,
            source: combined.source,
            sources: sources.sources(),
            verdict: self.verdict_of(&combined, is_fresh),
            skew_ppm: band.skew_ppm(),
            exchanges: band.exchange_count(),
            age: band.newest_return().map(|newest| (at - newest).max(Span::ZERO)),
        })
    }

    /// Returns the numbers of accepted and refused exchanges.
    pub const fn exchange_counts(&self) -> ExchangeCounts {
        self.exchange_counts
    }

    /// Returns the skew that the exchanges of the current band prove, whatever their delays were. `None` without
    /// enough exchanges.
    pub fn proven_skew(&self) -> Option<ProvenSkew> {
        self.bands.current().proven_skew()
    }

    /// Returns the age that an exchange can have and still bound the offset at a time: the window of the settings, or
    /// the age of the oldest of the newest eight exchanges if that is more. `None` without exchanges.
    pub fn window_span(&self, at: RawTime) -> Option<Span> {
        self.bands.current().window_span(at)
    }

    /// Returns the limit that the clocks seem to violate; `None` if the clocks seem to violate no limit. If a limit is
    /// violated, delays are `inconsistent`.
    ///
    /// A limit is violated if exchanges prove a skew beyond the limit, or if exchanges contradict each other
    /// repeatedly. A peer that sends wrong stamps has the same effect.
    pub fn violated_limit(&self) -> Option<ViolatedLimit> {
        if self.excess_skew().is_some() {
            return Some(ViolatedLimit::Drift);
        }
        self.contradictions.unannounced_steps.violated_limit(self.bands.current().newest_return()?)
    }

    /// Returns the proven skew if it is beyond the limit of drift; else `None`.
    pub fn excess_skew(&self) -> Option<ProvenSkew> {
        self.bands.current().excess_skew()
    }

    /// Returns whether the clocks seem to violate a limit.
    pub fn violates_limit(&self) -> bool {
        self.violated_limit().is_some()
    }

    /// Returns the memory of the exchanges, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.bands.memory_bytes()
            + self.contradictions.suspects.memory_bytes()
            + self.exchange_times.memory_bytes()
    }

    /// Checks a finished exchange, and inserts it unless it is refused.
    pub fn learn(&mut self, observation: &ExchangeObservation) -> LearnResult {
        let result = self.check_and_insert(observation);
        let counts = &mut self.exchange_counts;
        match result {
            LearnResult::Accepted
            | LearnResult::Restarted(_)
            | LearnResult::Jumped(_)
            | LearnResult::Ignored => {
                counts.accepted += 1;
                self.exchange_times.insert(observation.exchange.returned);
            }
            LearnResult::Refused(Refusal::Impossible) => counts.impossible += 1,
            LearnResult::Refused(Refusal::Outlier) => counts.outliers += 1,
            LearnResult::Refused(Refusal::Stepped) => counts.stepped += 1,
        }
        result
    }

    /// Learns an exchange again, now with a better stamp of the answer's departure. The exchange counts once.
    pub fn refine(&mut self, observation: &ExchangeObservation) -> LearnResult {
        self.check_and_insert(observation)
    }

    /// Starts a new band if `epoch` is higher than the last known epoch of the edge's clock, or is the first one.
    pub fn restart_after_edge_step(&mut self, epoch: u32) {
        if self.steps.update_edge_epoch(epoch) {
            self.claims.edge = None;
            self.restart();
        }
    }

    /// Starts a new band if `epoch`, which the peer reported, is higher than the last known epoch of the cloud's
    /// clock, or is the first one.
    pub fn restart_after_cloud_step(&mut self, epoch: u32) {
        if self.steps.update_cloud_epoch(epoch) {
            self.claims.cloud = None;
            self.restart();
        }
    }

    /// Checks an exchange against its epochs and the current band, and inserts it if it passes.
    fn check_and_insert(&mut self, observation: &ExchangeObservation) -> LearnResult {
        let exchange = &observation.exchange;
        if !self.is_possible(exchange) {
            return LearnResult::Refused(Refusal::Impossible);
        }
        // The epochs count even if the exchange itself spans a step and is refused.
        let step_report = self.steps.compare(observation);
        self.claims.edge.take_if(|_| step_report.has_edge_step);
        self.claims.cloud.take_if(|_| step_report.has_cloud_step);
        if step_report.has_edge_step || step_report.has_cloud_step {
            self.restart();
        }
        if !step_report.is_current || !is_free_of_cloud_step(observation) || self.steps.excludes(exchange) {
            return LearnResult::Refused(Refusal::Stepped);
        }
        let bounds = Bounds::from(exchange);
        let contradiction = self.bands.contradiction(&bounds);
        let jump = match contradiction {
            Some(contradiction) => {
                if !self.replace_band_if_confirmed(&bounds, exchange.returned, contradiction) {
                    return LearnResult::Refused(Refusal::Outlier);
                }
                None
            }
            None if self.bands.may_precede_jump(exchange) => return LearnResult::Ignored,
            None => {
                let jump = self.bands.insert(exchange, &bounds);
                let suspects = &mut self.contradictions.suspects;
                if !suspects.is_empty() {
                    suspects.reconsider(&bounds, self.bands.current());
                }
                jump
            }
        };
        if let Some(movement) = jump {
            self.contradictions.suspects.clear();
            self.exchange_counts.restarts += 1;
            return LearnResult::Jumped(movement);
        }
        match self.estimate_before_restart.take() {
            None => LearnResult::Accepted,
            Some(estimate_before) => {
                let estimate_after = self.estimate_at(exchange.returned);
                LearnResult::Restarted(
                    estimate_before.zip(estimate_after).map(|(before, after)| after - before),
                )
            }
        }
    }

    /// Adds an exchange that contradicts the current band to the suspects. If enough suspects agree, their band replaces
    /// the current band, and the method returns `true`.
    fn replace_band_if_confirmed(
        &mut self,
        bounds: &Bounds,
        at: RawTime,
        contradiction: Contradiction,
    ) -> bool {
        let suspects = &mut self.contradictions.suspects;
        let Some((band, first_sent)) = suspects.add(bounds, || self.bands.new_band()) else {
            return false;
        };
        self.steps.exclude_sent_before(first_sent);
        self.restart();
        self.contradictions.unannounced_steps.record(at, contradiction);
        self.bands.restart_at(band, first_sent);
        true
    }

    /// Returns whether two clocks can produce these stamps:
    /// - the two stamps of each host are in order;
    /// - the round trip is not negative by more than the stamps' uncertainty and the clocks' drift;
    /// - the uncertainty is not negative;
    /// - no stamp and no bound exceeds [`MAX_STAMP`].
    fn is_possible(&self, exchange: &Exchange) -> bool {
        let Exchange { sent, received, replied, returned, uncertainty } = *exchange;
        let max_drift =
            Span::from_nanos(self.bands.limit().max_change_between(sent.nanos(), returned.nanos()));
        let is_too_large = [sent, received, replied, returned]
            .into_iter()
            .map(|stamp| stamp - RawTime::from_nanos(0))
            .chain([exchange.upper(), exchange.lower(), uncertainty])
            .any(|span| span.abs() > MAX_STAMP);
        !is_too_large
            && !uncertainty.is_negative()
            && returned >= sent
            && replied >= received
            && exchange.round_trip() + uncertainty + uncertainty + max_drift >= Span::ZERO
    }

    /// Starts a new band after a step of a clock.
    fn restart(&mut self) {
        self.contradictions.suspects.clear();
        // A step can be reported twice. The second report finds an empty band, and must not replace the estimate from
        // before the step.
        let Some(newest) = self.bands.current().newest_return() else { return };
        self.estimate_before_restart = Some(self.estimate_at(newest));
        self.bands.restart();
        self.exchange_times.clear();
        self.exchange_counts.restarts += 1;
    }

    /// Returns the estimate of the offset at a time, from the exchanges alone; `None` without exchanges.
    fn estimate_at(&self, at: RawTime) -> Option<Span> {
        self.bands.interval(at).map(|interval| self.bands.estimate(at, interval))
    }
}

/// Returns whether the cloud's clock advanced like its monotonic clock; `true` if the observation does not contain the
/// time of the monotonic clock.
fn is_free_of_cloud_step(ExchangeObservation { exchange, cloud_elapsed, .. }: &ExchangeObservation) -> bool {
    cloud_elapsed.is_none_or(|elapsed| {
        let limit = MAX_READING_DIFFERENCE
            + Span::from_nanos(elapsed.abs().nanos() / 1_000_000 * MAX_RATE_DIFFERENCE_PPM);
        (exchange.replied - exchange.received - elapsed).abs() <= limit
    })
}
