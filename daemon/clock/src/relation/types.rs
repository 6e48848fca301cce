//! What is asked of a relation and what it answers.

use serde::{Deserialize, Serialize};

use crate::{DelaySource, Interval, OneWayDelay, RelatedClocks, Span, Verdict, WallTime};

/// Which way a message went, seen from the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Edge to cloud.
    Up,
    /// Cloud to edge.
    Down,
}

/// What an estimate rests on, apart from the exchanges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelationSettings {
    /// Which clocks of the two hosts are related.
    pub clocks: RelatedClocks,
    /// The fastest that the two clocks may drift apart, parts per million. All bounds hold as long as this does.
    pub max_drift_ppm: f64,
    /// The fastest that their drift may change, parts per million per second. Where both run freely, all bounds hold as long as this
    /// does, too.
    pub max_drift_change_ppm_per_s: f64,
    /// How far from its own time an exchange bounds the offset, into the future and into the past. The newest eight bound it
    /// however far they are.
    pub window: Span,
    /// How long exchanges are kept for questions about the past; counts where it is longer than the window.
    pub retention: Span,
    /// A delay with no other exchange so near in time is `stale`.
    pub fresh: Span,
    /// Whether what both hosts' time daemons claim narrows the interval. A claim is nothing that an exchange proves: where a
    /// daemon is wrong about its clock, so is the interval.
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
            fresh: Span::from_seconds(10),
            trust_time_daemons: false,
        }
    }
}

/// Why an exchange was not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// No two clocks can show this: the answer left before the message came, or the round trip is negative.
    Impossible,
    /// It contradicts what all the others say; a clock was stepped only if more of its kind follow.
    Outlier,
    /// A clock was stepped while it was under way.
    Stepped,
}

/// What became of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Learned {
    /// It counts.
    Taken,
    /// It counts, and is the first of a new window: a clock was stepped before it. The offset moved by this much,
    /// by the estimates before and after, where there were any.
    Restarted(Option<Span>),
    /// It counts, and is the first of a new window: no host noticed a step, but the offset moved by this much at once, more than waiting
    /// on the way explains. The path between the hosts changed, or a clock jumped. Delays are `limited` until the
    /// window is full again.
    Jumped(Span),
    /// It does not count.
    Refused(Refusal),
}

/// An assumption about the two clocks that they seem not to keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Doubt {
    /// They drift apart faster than [`max_drift_ppm`](RelationSettings::max_drift_ppm).
    Drift,
    /// Their drift changes faster than [`max_drift_change_ppm_per_s`](RelationSettings::max_drift_change_ppm_per_s).
    DriftChange,
}

/// The offset between two clocks at one time: cloud minus edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offset {
    /// The edge's wall clock.
    pub at: WallTime,
    /// The best guess, within `bounds`; where it is `inconsistent`, that of `source` alone.
    pub estimate: Span,
    /// Contain the truth as long as the clocks drift apart no faster than the stated limit. Where it is `inconsistent`
    /// they hold what each of the sources says: one of them is wrong, and it is not known which.
    pub bounds: Interval,
    /// What the bounds rest on; where it is `inconsistent`, what the estimate does.
    pub source: DelaySource,
    /// Every source and what it says alone, for comparison: `in-band` first.
    pub sources: Vec<(DelaySource, Interval)>,
    /// `ok`, `stale` or `inconsistent`; other verdicts are a delay's.
    pub verdict: Verdict,
    /// How fast the offset grows by the exchanges of the window, parts per million; `None` before there are enough.
    pub skew_ppm: Option<f64>,
    /// Exchanges that the window was given.
    pub exchanges: u64,
    /// From the newest exchange to `at`; `None` when there is none.
    pub age: Option<Span>,
}

/// How many exchanges were taken and refused, since the relation was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExchangeCounts {
    /// Taken.
    pub taken: u64,
    /// Refused: impossible.
    pub impossible: u64,
    /// Refused: outliers.
    pub outliers: u64,
    /// Refused: a clock was stepped on the way.
    pub stepped: u64,
    /// Windows begun after a step or a suspected jump.
    pub restarts: u32,
}

/// The delays of a message and of its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Judged {
    /// What became of the exchange itself.
    pub learned: Learned,
    /// Edge to cloud.
    pub up: OneWayDelay,
    /// Cloud to edge.
    pub down: OneWayDelay,
}
