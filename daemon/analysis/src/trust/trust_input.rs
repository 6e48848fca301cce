//! Values that the trust findings of a run are computed from.

use std::collections::BTreeMap;

use peernet_clock::{OneWayDelay, Verdict};
use peernet_logger::{Name, stage};
use peernet_statistics::{Summary, TwoModes};
use peernet_stream::{Condition, EndReason, FaultyHost};

use super::replayed::mean_drawn_and_overrun;
use super::{EndedEarly, ReplayedLatencies, Restarts, Starts, TimeSeries};
use crate::accuracy::{Accuracy, UnknownLabels};
use crate::actuator_results::ActuatorResults;
use crate::answer_length::{answer_tokens, tokens_of_column};
use crate::delays::{ClockInterval, VerdictCounts};
use crate::order::SortedValues;
use crate::outcomes::Counts;
use crate::rows::{RowRef, Rows};
use crate::stage_split::StageSplit;
use crate::total_column::TotalColumn;

/// Function that returns the delay of a row's message in one direction.
type DelayReader = fn(&RowRef<'_>) -> Option<OneWayDelay>;

/// Values that the trust findings of a run are computed from. A value that is not known is `None` or empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrustInput {
    /// Conditions of the hosts that were found before the run.
    pub conditions: Vec<Condition>,
    /// Number of iterations by outcome.
    pub counts: Counts,
    /// Numbers of actual and of skipped starts of an open loop.
    pub starts: Starts,
    /// Measurements that are missing.
    pub missing: Vec<MissingEvents>,
    /// Reason for which the run broke off. `None` if the run finished, was stopped or is in progress.
    pub failure: Option<String>,
    /// True if the run has not ended yet.
    pub in_progress: bool,
    /// Progress of the run, if it ended before its limit.
    pub ended_early: Option<EndedEarly>,
    /// True if the clock of a host was made wrong on purpose.
    pub has_clock_fault: bool,
    /// Total of each iteration, or `sensing` if no iteration has a total. `None` without such values.
    pub total: Option<TimeSeries>,
    /// Duration of each stage, by name.
    pub stages: Vec<(String, TimeSeries)>,
    /// Split of the mean total into its stages.
    pub split: StageSplit,
    /// Number of iterations in the statistics whose answer was not acted on, because it was superseded.
    pub superseded: u64,
    /// Distributions that have two modes, by name. Only the total and the length of answers in tokens are tested.
    pub two_modes: Vec<(String, TwoModes)>,
    /// Processes that were restarted while iterations waited for them.
    pub restarts: Vec<Restarts>,
    /// Quality of the one-way delays, for each direction.
    pub clocks: Vec<DelayQuality>,
    /// Accuracy of the model, by column; empty if the right answers are not known.
    pub accuracy: BTreeMap<String, Accuracy>,
    /// Samples whose label is not a class of the model. Their answers are neither right nor wrong.
    pub unknown_labels: Option<UnknownLabels>,
    /// Distribution from which the latencies of the model are drawn; `None` if the latencies are measured.
    pub replayed: Option<String>,
    /// Mean drawn latency, seconds; `None` if no latencies are drawn.
    pub drawn: Option<f64>,
    /// Mean time by which `inference` took longer than the drawn latencies, seconds; `None` if no latencies are drawn.
    pub overrun: Option<f64>,
}

/// Events that were dropped or never arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingEvents {
    /// Number of missing events; 0 if the number is not known.
    pub count: u64,
    /// Reason for which the events are missing.
    pub reason: String,
}

/// Quality of the one-way delays of a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct DelayQuality {
    /// `upload` or `download`.
    pub stage: String,
    /// Number of delays by verdict.
    pub verdicts: Vec<(Verdict, u64)>,
    /// Median of the known delays, seconds; `None` if no delay is known.
    pub delay: Option<f64>,
    /// Interval that the clock bounds give for the median delay, seconds; `None` unless every known delay has bounds.
    pub interval: Option<ClockInterval>,
}

impl TrustInput {
    /// Returns the input from the rows of a run and from the conditions of the hosts that were found before the run.
    pub fn from_rows(rows: &Rows, conditions: &[Condition]) -> Self {
        let in_statistics = || rows.iter().filter(|row| row.is_in_statistics());
        let time_series =
            |column: &str| TimeSeries::from_values(&rows.values_in_statistics(column).collect::<Vec<f64>>());
        let [drawn, overrun] = mean_drawn_and_overrun(rows);
        let stages =
            stage::ORDER.into_iter().filter_map(|name| Some((name.to_string(), time_series(&name)?)));
        let directions: [(Name, DelayReader); 2] =
            [(stage::UPLOAD, |row| row.upload()), (stage::DOWNLOAD, |row| row.download())];
        Self {
            conditions: conditions.to_vec(),
            counts: Counts::from_rows(rows, 0),
            starts: Starts::from_rows(rows),
            total: TotalColumn::Measured.latency_names().iter().find_map(|name| time_series(name)),
            stages: stages.collect(),
            split: StageSplit::from_rows(rows),
            drawn,
            overrun,
            superseded: ActuatorResults::from_rows(rows).superseded,
            two_modes: two_modes(rows),
            restarts: Restarts::from_rows(rows),
            clocks: directions
                .into_iter()
                .filter_map(|(name, delay)| {
                    DelayQuality::from_delays(name.as_str(), in_statistics().filter_map(|row| delay(&row)))
                })
                .collect(),
            accuracy: Accuracy::by_column(rows),
            // `with_facts` adds the examples, which are facts of the run.
            unknown_labels: UnknownLabels::from_rows(rows, &[]),
            ..Self::default()
        }
    }

    /// Adds the reason for which the run broke off, if `reason` is a failure.
    #[must_use]
    pub fn with_end_reason(self, reason: Option<&EndReason>) -> Self {
        Self { failure: reason.and_then(EndReason::failure).map(str::to_owned), ..self }
    }

    /// Adds the facts of the run about clock faults, labels, classes and replayed latencies.
    #[must_use]
    pub fn with_facts(self, facts: &[(String, String)]) -> Self {
        let has_clock_fault = facts.iter().any(|(fact, _)| FaultyHost::from_fact_name(fact).is_some());
        let unknown_labels = self.unknown_labels.and_then(|unknown| UnknownLabels::new(unknown.count, facts));
        let replayed = ReplayedLatencies::from_facts(facts).map(|replayed| replayed.distribution);
        Self { has_clock_fault, unknown_labels, replayed, ..self }
    }

    /// Returns the replayed latencies of the run; `None` if the latencies are measured.
    pub fn replayed_latencies(&self) -> Option<ReplayedLatencies> {
        let distribution = self.replayed.clone()?;
        Some(ReplayedLatencies { distribution, drawn: self.drawn, overrun: self.overrun })
    }
}

/// Returns the names of the distributions that may have two modes: the total, or `sensing` if there is no total,
/// and the length of answers in tokens. `names` are the names of all quantities.
pub fn names_of_distributions<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Vec<&'a str> {
    let mut latency = TotalColumn::Measured.latency_names().into_iter();
    let latency = latency.find_map(|name| names.clone().find(|other| name == **other));
    latency.into_iter().chain(answer_tokens(names)).collect()
}

fn two_modes(rows: &Rows) -> Vec<(String, TwoModes)> {
    let modes_of = |name: &str| {
        let mut summary = Summary::default();
        rows.values_in_statistics(name).for_each(|value| summary.record(value));
        // The store names nodes without the names of their parents. The same name is used here, so that both sources
        // give equal reports.
        let node = tokens_of_column(name).unwrap_or(name);
        Some((node.to_owned(), summary.two_modes()?))
    };
    names_of_distributions(rows.columns_in_statistics()).into_iter().filter_map(modes_of).collect()
}

impl DelayQuality {
    fn from_delays(stage: &str, delays: impl Iterator<Item = OneWayDelay> + Clone) -> Option<Self> {
        let verdicts: VerdictCounts = delays.clone().map(|delay| delay.verdict).collect();
        let known = delays.filter_map(|delay| Some((delay.known_seconds()?, delay.known_bounds())));
        (!verdicts.is_empty()).then(|| Self {
            stage: stage.to_owned(),
            verdicts: verdicts.counts().collect(),
            delay: known.clone().map(|(seconds, _)| seconds).collect::<SortedValues>().median(),
            interval: ClockInterval::of_median(known.map(|(_, bounds)| bounds)),
        })
    }
}
