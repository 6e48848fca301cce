//! Input of a run's judgement, from any source.

use std::collections::BTreeMap;

use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_stream::{Condition, EndReason, FaultyHost};

use super::{EndedEarly, Restarts, Starts, TimeSeries};
use crate::Passage;
use crate::accuracy::{Accuracy, UnknownLabels};
use crate::order::SortedValues;
use crate::rows::{LATENESS, Outcome, RowRef, Rows};

/// Name of the fact by which a model says that its latencies are drawn from a distribution.
const REPLAYED_FACT: &str = "Replayed";

/// Node with the time by which the inner model of drawn latencies took longer than drawn.
pub const OVERRUN: &str = "overrun";
/// Its column in `data.csv`.
const OVERRUN_COLUMN: &str = "inference_overrun";

/// Function that returns a row's message in one direction.
type PassageReader = fn(&RowRef<'_>) -> Option<Passage>;

/// Input of a run's judgement. A field whose value is unknown is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrustInput {
    /// Conditions of the hosts that were found before the run.
    pub conditions: Vec<Condition>,
    /// Number of iterations by how they ended.
    pub counts: Counts,
    /// Starts that an open loop ordered, by their outcome.
    pub starts: Starts,
    /// Measurements that are missing.
    pub missing: Vec<MissingEvents>,
    /// Reason for which the run broke off. `None` if it finished or was stopped.
    pub failure: Option<String>,
    /// `true` if it has no end yet.
    pub open: bool,
    /// Progress of the run, if it ended before its limit.
    pub ended_early: Option<EndedEarly>,
    /// `true` if the clock of a host was made wrong on purpose.
    pub has_clock_fault: bool,
    /// Total of each iteration, or `sensing` if the pipeline only senses. `None` without such values.
    pub total: Option<TimeSeries>,
    /// The stages, by name.
    pub stages: Vec<(String, TimeSeries)>,
    /// Average of the total minus its stages; seconds. Negative if stages overlap.
    pub unattributed: Option<f64>,
    /// Average part of that time that is known to be lateness; seconds. `None` in a closed loop.
    pub lateness: Option<f64>,
    /// Processes that were restarted while iterations waited for them.
    pub restarts: Vec<Restarts>,
    /// The judged one-way delays, by stage.
    pub clocks: Vec<Clocks>,
    /// Accuracy of the model, by column; empty if the right answers are not known.
    pub accuracy: BTreeMap<String, Accuracy>,
    /// Samples that are neither right nor wrong, because their label is not a class of the model.
    pub unknown_labels: Option<UnknownLabels>,
    /// Distribution from which the latencies of the model are drawn; `None` if they are measured.
    pub replayed: Option<String>,
    /// Average time by which the inner model of drawn latencies took longer than drawn; seconds. `None` without one.
    pub overrun: Option<f64>,
}

/// Returns the distribution from which the latencies of a run's model are drawn, by the facts of the run; `None` if they
/// are measured.
pub fn replayed_latencies(facts: &[(String, String)]) -> Option<&str> {
    facts.iter().find(|(name, _)| name == REPLAYED_FACT).map(|(_, text)| text.as_str())
}

/// Number of iterations of a run by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Iterations with an answer. Warm-up is left out of all counts but `warm_up`.
    pub ok: u64,
    /// Iterations whose sample or model failed.
    pub failed: u64,
    /// Iterations that will never be answered.
    pub lost: u64,
    /// Iterations not answered in time.
    pub timeout: u64,
    /// Iterations of the warm-up, which statistics exclude.
    pub warm_up: u64,
}

/// Events that were dropped or never arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingEvents {
    /// Number of missing events; 0 if it is not known.
    pub count: u64,
    /// Reason for which they are missing.
    pub reason: String,
}

/// Quality of the one-way delays of a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Clocks {
    /// `upload` or `download`.
    pub stage: String,
    /// Number of delays by verdict.
    pub verdicts: Vec<(Verdict, u64)>,
    /// The median delay, seconds.
    pub delay: Option<f64>,
    /// The median of half the width of its bounds, seconds.
    pub half_width: Option<f64>,
}

impl TrustInput {
    /// Returns the input from the rows of a run and the conditions of its hosts that were found before it.
    pub fn from_rows(rows: &Rows, conditions: &[Condition]) -> Self {
        let measured = || rows.iter().filter(|row| row.is_counted());
        let time_series =
            |column: &str| TimeSeries::from_values(&rows.counted_values(column).collect::<Vec<f64>>());
        // Both sums cover the same iterations: if a delay is not known, the unattributed time is not known either.
        let explained = || measured().filter(|row| row.value(&stage::UNATTRIBUTED).is_some());
        let mean = |column: &str| {
            let values = || explained().filter_map(|row| row.value(column));
            let count = values().count();
            (count > 0).then(|| values().sum::<f64>() / count as f64)
        };
        let stages =
            stage::ORDER.into_iter().filter_map(|name| Some((name.to_string(), time_series(&name)?)));
        let count = |outcome: Outcome| {
            rows.iter().filter(|row| !row.warm_up() && row.outcome() == outcome).count() as u64
        };
        let directions: [(Name, PassageReader); 2] =
            [(stage::UPLOAD, |row| row.upload()), (stage::DOWNLOAD, |row| row.download())];
        Self {
            conditions: conditions.to_vec(),
            counts: Counts {
                ok: measured().count() as u64,
                failed: count(Outcome::Failed),
                lost: count(Outcome::Lost),
                timeout: count(Outcome::Timeout),
                warm_up: rows.iter().filter(|row| row.warm_up()).count() as u64,
            },
            starts: Starts::from_rows(rows),
            total: time_series(&stage::TOTAL).or_else(|| time_series(&stage::SENSING)),
            stages: stages.collect(),
            unattributed: mean(&stage::UNATTRIBUTED),
            lateness: mean(LATENESS),
            overrun: mean(OVERRUN_COLUMN),
            restarts: Restarts::from_rows(rows),
            clocks: directions
                .into_iter()
                .filter_map(|(name, of)| {
                    Clocks::from_passages(name.as_str(), measured().filter_map(|row| of(&row)))
                })
                .collect(),
            accuracy: Accuracy::by_column(rows),
            unknown_labels: UnknownLabels::from_rows(rows, &[]),
            ..Self::default()
        }
    }

    /// Adds the reason for the run's end.
    #[must_use]
    pub fn with_end_reason(self, reason: Option<&EndReason>) -> Self {
        Self { failure: reason.and_then(EndReason::failure).map(str::to_owned), ..self }
    }

    /// Adds the facts of the run's description about clock faults, labels, classes and replayed latencies.
    #[must_use]
    pub fn with_facts(self, facts: &[(String, String)]) -> Self {
        let has_clock_fault = facts.iter().any(|(fact, _)| FaultyHost::of_fact(fact).is_some());
        let unknown_labels = self.unknown_labels.and_then(|unknown| UnknownLabels::new(unknown.count, facts));
        let replayed = replayed_latencies(facts).map(str::to_owned);
        Self { has_clock_fault, unknown_labels, replayed, ..self }
    }
}

impl Counts {
    /// Returns the number of iterations that should be in the statistics.
    pub const fn measured(&self) -> u64 {
        self.ok + self.unanswered()
    }

    /// Returns the number of iterations that have no answer.
    pub const fn unanswered(&self) -> u64 {
        self.failed + self.lost + self.timeout
    }
}

impl Clocks {
    fn from_passages(stage: &str, passages: impl Iterator<Item = Passage>) -> Option<Self> {
        let mut verdicts = BTreeMap::<usize, (Verdict, u64)>::new();
        let (mut delays, mut half_widths) = (Vec::new(), Vec::new());
        for passage in passages {
            let verdict = passage.delay.verdict;
            let place = Verdict::ALL.iter().position(|known| *known == verdict).unwrap_or(usize::MAX);
            verdicts.entry(place).or_insert((verdict, 0)).1 += 1;
            delays.extend(passage.seconds());
            half_widths.extend(passage.bounds().map(|(lo, hi)| (hi - lo) / 2.0));
        }
        let median = |values: Vec<f64>| values.into_iter().collect::<SortedValues>().median();
        let verdicts: Vec<(Verdict, u64)> = verdicts.into_values().collect();
        (!verdicts.is_empty()).then(|| Self {
            stage: stage.to_owned(),
            verdicts,
            delay: median(delays),
            half_width: median(half_widths),
        })
    }
}
