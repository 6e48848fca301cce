//! Settings and results of a relation.

use serde::{Deserialize, Serialize};

use crate::{DelaySource, Interval, OneWayDelay, RelatedClocks, Span, Verdict, WallTime};

/// Direction of a message as seen from the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Edge to cloud.
    Up,
    /// Cloud to edge.
    Down,
}

impl Direction {
    /// Both directions, in the order of declaration.
    pub const ALL: [Self; 2] = [Self::Up, Self::Down];
}

/// Settings of a relation: its clocks, the limits of their drift, and the exchanges that count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelationSettings {
    /// Clocks of the two hosts that are related.
    pub clocks: RelatedClocks,
    /// Largest drift between the two clocks, parts per million. All bounds hold as long as the clocks keep this limit.
    pub max_drift_ppm: f64,
    /// Largest speed at which the drift changes, parts per million per second. Used only if both clocks run freely: all
    /// bounds then hold as long as the clocks keep this limit, too.
    pub max_drift_change_ppm_per_s: f64,
    /// Largest time between an exchange and a query at which the exchange still bounds the offset. The newest eight
    /// exchanges bound the offset at any distance.
    pub window: Span,
    /// Time for which exchanges are kept to answer queries about the past. A value below `window` counts as `window`.
    pub retention: Span,
    /// A delay is `stale` if the nearest other exchange is farther away in time than this.
    pub max_fresh_age: Span,
    /// `true` if the claims of both hosts' time daemons narrow the interval. No exchange proves a claim: if a daemon is
    /// wrong about its clock, the interval is wrong, too.
    pub trust_time_daemons: bool,
}

impl Default for RelationSettings {
    fn default() -> Self {
        Self {
            clocks: RelatedClocks::default(),
            max_drift_ppm: 200.0,
            max_drift_change_ppm_per_s: 1.0,
            window: Span::from_seconds(10),
            retention: Span::from_seconds(10),
            max_fresh_age: Span::from_seconds(10),
            trust_time_daemons: false,
        }
    }
}

/// Reason why an exchange was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// No two clocks can produce the stamps: the answer left before the message arrived, or the round trip is negative.
    Impossible,
    /// The exchange contradicts earlier exchanges. If further exchanges agree with it, a step is assumed.
    Outlier,
    /// A clock was stepped while the exchange was in flight.
    Stepped,
}

/// Result of learning an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LearnResult {
    /// The exchange was accepted.
    Accepted,
    /// The exchange was accepted, and the exchanges before it no longer count, because a clock was stepped before it.
    /// The value is the estimate after the step minus the estimate before it, if both exist.
    Restarted(Option<Span>),
    /// The exchange was accepted, and the exchanges before it no longer count for later times, because a jump is
    /// suspected: the offset moved by more than queueing on the network explains. The value is the movement of the
    /// offset. Either the path between the hosts changed, or a clock jumped without notice. Delays are `limited` until
    /// [`window`](RelationSettings::window) has passed since the jump.
    Jumped(Span),
    /// The exchange bounds no offset, because it may be from before a suspected jump: it was sent before the exchange
    /// that showed the jump, and learnt after it. It counts as accepted.
    Ignored,
    /// The exchange was refused.
    Refused(Refusal),
}

/// A limit that the two clocks seem to violate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ViolatedLimit {
    /// The clocks drift apart faster than [`max_drift_ppm`](RelationSettings::max_drift_ppm).
    Drift,
    /// The drift changes faster than [`max_drift_change_ppm_per_s`](RelationSettings::max_drift_change_ppm_per_s).
    DriftChange,
}

/// The offset between two clocks at one time: cloud minus edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offset {
    /// Time of the edge's wall clock at which the offset holds.
    pub at: WallTime,
    /// Estimate within `bounds`; if the verdict is `inconsistent`, the estimate of `source` alone.
    pub estimate: Span,
    /// Interval that contains the true offset as long as the clocks keep the limits of drift. If the verdict is
    /// `inconsistent`, the interval contains the intervals of all sources, of which at least one is wrong.
    pub bounds: Interval,
    /// Source of the bounds; if the verdict is `inconsistent`, source of the estimate.
    pub source: DelaySource,
    /// Each source and its own interval, for comparison; `in-band` first.
    pub sources: Vec<(DelaySource, Interval)>,
    /// `ok`, `stale` or `inconsistent`. Other verdicts apply to delays only.
    pub verdict: Verdict,
    /// Rate at which the offset changes, parts per million, from the exchanges since the last step or suspected jump;
    /// `None` without enough exchanges.
    pub skew_ppm: Option<f64>,
    /// Number of exchanges since the last step or suspected jump.
    pub exchanges: u64,
    /// Time from the newest exchange to `at`; `None` without exchanges.
    pub age: Option<Span>,
}

impl Offset {
    /// Returns whether sources and exchanges agree. An offset without agreement has no value.
    pub fn is_consistent(&self) -> bool {
        self.verdict != Verdict::Inconsistent
    }

    /// Returns the rate at which the offset changes, parts per million; `None` without enough exchanges, or if sources
    /// or exchanges contradict each other.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.skew_ppm.filter(|_| self.is_consistent())
    }
}

/// Numbers of accepted and refused exchanges since the relation was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExchangeCounts {
    /// Number of accepted exchanges.
    #[serde(rename = "taken")]
    pub accepted: u64,
    /// Number of exchanges that were refused because no two clocks can produce their stamps.
    pub impossible: u64,
    /// Number of exchanges that were refused as outliers.
    pub outliers: u64,
    /// Number of exchanges that were refused because a clock was stepped while they were in flight.
    pub stepped: u64,
    /// Number of steps and suspected jumps after which earlier exchanges no longer counted.
    pub restarts: u32,
}

/// Delays of a message and of its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JudgedExchange {
    /// Result of learning the exchange itself.
    pub learn_result: LearnResult,
    /// Delay of the message, edge to cloud.
    pub up: OneWayDelay,
    /// Delay of the answer, cloud to edge.
    pub down: OneWayDelay,
}
