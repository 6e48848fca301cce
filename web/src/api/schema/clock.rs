//! What is known of hosts' wall clocks.

use peernet_clock::{DelaySource, Discipline, Interval, Offset, RehearsalDescription, Span};
use peernet_store as store;
use peernet_stream::{self as stream, DelayPoint, DelaySecond, ProbeCounts};
use serde::Serialize;
use utoipa::ToSchema;

use super::figures::VerdictCount;
use super::{Figures, time};
use crate::view::link::known;

/// An interval that contains the truth, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Bounds {
    pub lo_s: f64,
    pub hi_s: f64,
}

impl From<Interval> for Bounds {
    fn from(interval: Interval) -> Self {
        Self { lo_s: interval.lo.seconds(), hi_s: interval.hi.seconds() }
    }
}

/// One host's wall clock, by its own account.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HostClock {
    /// What its time daemon, or the kernel, claims; null when it is not synchronised or nobody says.
    pub discipline: Option<Claim>,
    /// In words: `chrony, stratum 2, to 10.0.0.1`, `not synchronised`.
    pub text: String,
    /// How often the clock was found stepped, run off or asleep, since the agent started.
    pub epoch: u32,
    /// How it is made wrong on purpose; null when it is not.
    pub rehearsal: Option<Rehearsal>,
}

/// A claim about a wall clock: what it shows minus true time lies within an interval.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Claim {
    /// `kernel` or `chrony`.
    pub source: &'static str,
    pub error: Bounds,
}

/// How a clock is made wrong on purpose.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Rehearsal {
    /// Ahead from the start.
    pub offset_s: f64,
    /// Runs fast by so many parts per million.
    pub drift_ppm: f64,
    pub steps: Vec<RehearsalStep>,
    /// What the true clock showed at the start.
    pub since: String,
}

/// A step of a clock that is made wrong on purpose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RehearsalStep {
    /// So long after the start.
    pub at_s: f64,
    /// By so much.
    pub by_s: f64,
}

impl From<&RehearsalDescription> for Rehearsal {
    fn from(rehearsal: &RehearsalDescription) -> Self {
        let steps = rehearsal.steps.iter();
        Self {
            offset_s: rehearsal.offset.seconds(),
            drift_ppm: rehearsal.drift_ppm,
            steps: steps
                .map(|step| RehearsalStep { at_s: step.at.seconds(), by_s: step.by.seconds() })
                .collect(),
            since: time(rehearsal.since),
        }
    }
}

impl From<&stream::HostClock> for HostClock {
    fn from(clock: &stream::HostClock) -> Self {
        let claim = |discipline: Discipline| Claim {
            source: discipline.source.name(),
            error: discipline.error.into(),
        };
        Self {
            discipline: clock.discipline.map(claim),
            text: clock.text.clone(),
            epoch: clock.epoch,
            rehearsal: clock.rehearsal.as_ref().map(Rehearsal::from),
        }
    }
}

/// The offset between two wall clocks at one time: cloud minus edge.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ClockOffset {
    /// The best guess, seconds; null with its bounds when the verdict is `inconsistent`: then nothing is known.
    pub estimate_s: Option<f64>,
    pub lo_s: Option<f64>,
    pub hi_s: Option<f64>,
    /// What the bounds rest on: `same-clock`, `in-band`, `kernel`, `chrony`, `intersection` or `none`.
    pub source: &'static str,
    /// Every source and what it says alone.
    pub sources: Vec<Source>,
    /// `ok`, `stale` or `inconsistent`.
    pub verdict: &'static str,
    /// How fast the offset grows, parts per million; null before there are enough exchanges.
    pub skew_ppm: Option<f64>,
    /// Exchanges of the window.
    pub exchanges: u64,
    /// Seconds since the newest exchange.
    pub age_s: Option<f64>,
}

/// What one source says of an offset.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Source {
    pub source: &'static str,
    pub lo_s: f64,
    pub hi_s: f64,
}

impl From<&Offset> for ClockOffset {
    fn from(offset: &Offset) -> Self {
        let sources = offset.sources.iter().map(|(source, interval)| Source {
            source: source.name(),
            lo_s: interval.lo.seconds(),
            hi_s: interval.hi.seconds(),
        });
        let consistent = known(offset).is_some();
        let value = |span: Span| consistent.then(|| span.seconds());
        Self {
            estimate_s: value(offset.estimate),
            lo_s: value(offset.bounds.lo),
            hi_s: value(offset.bounds.hi),
            source: if consistent { offset.source } else { DelaySource::None }.name(),
            sources: sources.collect(),
            verdict: offset.verdict.name(),
            skew_ppm: offset.skew_ppm.filter(|_| consistent),
            exchanges: offset.exchanges,
            age_s: offset.age.map(Span::seconds),
        }
    }
}

/// What became of probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Probes {
    pub sent: u32,
    pub answered: u32,
    /// Did not come back in time.
    pub lost: u32,
}

impl From<ProbeCounts> for Probes {
    fn from(ProbeCounts { sent, answered, lost }: ProbeCounts) -> Self {
        Self { sent, answered, lost }
    }
}

/// Round trips of probes, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RoundTrip {
    pub min_s: f64,
    pub median_s: f64,
}

/// The delays of data in one direction.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Delay {
    /// How many were judged.
    pub count: u32,
    /// The worst verdict that at least a twentieth of them were given.
    pub verdict: &'static str,
    /// The median of those that have a value, with the bounds of that very one; null when none has.
    pub median: Option<MedianDelay>,
}

/// A delay as a point with its error bar.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct MedianDelay {
    pub value_s: f64,
    pub lo_s: f64,
    pub hi_s: f64,
    /// Over `value_s`; where the verdict is `limited` only its interval, by `lo_s` and `hi_s`, is known.
    pub bits_per_second: Option<f64>,
}

impl From<DelayPoint> for MedianDelay {
    fn from(point: DelayPoint) -> Self {
        let (lo_s, hi_s) = crate::view::link::delays::bounds(&point);
        Self { value_s: point.value.seconds(), lo_s, hi_s, bits_per_second: point.bits_per_second }
    }
}

impl From<&DelaySecond> for Delay {
    fn from(second: &DelaySecond) -> Self {
        let median = second.median.filter(|point| !point.value.is_negative());
        Self { count: second.count, verdict: second.verdict.name(), median: median.map(MedianDelay::from) }
    }
}

/// The one-way delays of a run as they were judged while it ran, and as all exchanges judge them, those after it
/// included.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Recomputed {
    pub run: i64,
    /// Stored clock samples that were used.
    pub samples: u64,
    /// `upload`, `download`.
    pub stages: Vec<RecomputedStage>,
}

/// One direction, before and after. Successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RecomputedStage {
    pub stage: String,
    /// As stored.
    pub before: Judgement,
    /// As computed again.
    pub after: Judgement,
}

/// Delays and how well they are known.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Judgement {
    /// Of the delays that have a value, seconds.
    pub delay: Option<Figures>,
    /// Of half the width of their bounds, seconds.
    pub half_width: Option<Figures>,
    pub verdicts: Vec<VerdictCount>,
}

impl From<&store::Judgement> for Judgement {
    fn from(judgement: &store::Judgement) -> Self {
        let verdicts = judgement.verdicts.iter();
        Self {
            delay: judgement.delay.map(Figures::from),
            half_width: judgement.half_width.map(Figures::from),
            verdicts: verdicts
                .map(|(verdict, count)| VerdictCount { verdict: verdict.name(), count: *count })
                .collect(),
        }
    }
}

impl From<&store::Recomputed> for Recomputed {
    fn from(recomputed: &store::Recomputed) -> Self {
        let stages = recomputed.stages.iter().map(|stage| RecomputedStage {
            stage: stage.stage.to_string(),
            before: Judgement::from(&stage.before),
            after: Judgement::from(&stage.after),
        });
        Self { run: recomputed.number, samples: recomputed.samples, stages: stages.collect() }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn what_contradicts_itself_has_no_value() {
        let sample = samples::clock_sample(samples::NOW, 1, Some(0.0005));
        let known = sample.offset.expect("known");
        let consistent = ClockOffset::from(&known);
        assert_eq!((consistent.estimate_s, consistent.source), (Some(1.204), "intersection"));
        let told = ClockOffset::from(&Offset { verdict: Verdict::Inconsistent, ..known });
        assert_eq!((told.estimate_s, told.lo_s, told.hi_s, told.skew_ppm), (None, None, None, None));
        assert_eq!((told.source, told.verdict, told.sources.len()), ("none", "inconsistent", 2));
    }
}
