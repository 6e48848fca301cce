//! Choice of the runs that count. Comparisons and studies use only runs that count. A run can count if it was measured
//! to its end, or if the command names it. If several runs measured the same repeat of a configuration, the newest of
//! them counts. An older run counts only if the command names it.

use std::collections::{HashMap, HashSet};
use std::fmt;

use peernet_clock::{Span, WallTime};
use peernet_logger::{HostId, RunId};
use peernet_stream::{EndReason, ExperimentPosition};

use crate::loaded::Loaded;

/// Progress of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunState {
    /// The run has not begun.
    Pending,
    /// The run has no recorded end: it is in progress, or its program was killed.
    Open,
    /// The run was measured to its end.
    Finished,
    /// Somebody ended the run.
    Interrupted,
    /// The run could not be measured to its end. The reason is `None` if it is not known.
    Failed(Option<String>),
}

impl RunState {
    /// Returns the state of a run that began, from the reason for its end. `reason` is `None` for a run without a
    /// recorded end.
    pub fn from_end_reason(reason: Option<&EndReason>) -> Self {
        match reason {
            None | Some(EndReason::Unknown) => Self::Open,
            Some(EndReason::Finished) => Self::Finished,
            Some(EndReason::Stopped) => Self::Interrupted,
            Some(EndReason::Failed(reason)) => Self::Failed(Some(reason.clone())),
        }
    }

    /// Returns whether the run was measured to its end. A run that was not measured to its end counts only if the
    /// command names it.
    pub const fn is_finished(&self) -> bool {
        matches!(self, Self::Finished)
    }

    /// Returns the name of the state. The name does not say whether an open run is still in progress, because this is
    /// not recorded.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Pending => "to do",
            Self::Open => "in progress or killed",
            Self::Finished => "finished",
            Self::Interrupted => "interrupted",
            Self::Failed(_) => "failed",
        }
    }
}

/// Writes the name, and the reason if the run failed.
impl fmt::Display for RunState {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Failed(Some(reason)) => write!(formatter, "failed ({reason})"),
            state => formatter.write_str(state.name()),
        }
    }
}

/// Reason why a run does not count. An index is the position of a run in the argument of [`exclusions`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Exclusion {
    /// The run was not measured to its end.
    Unfinished(RunState),
    /// The run with this index was not measured to its end. It is the run of another edge or of another pipeline, which
    /// measured the same repeat at the same time.
    ConcurrentRunUnfinished(usize),
    /// At least one edge of the experiment has no run of the repeat that was measured to its end: for example, the edge
    /// failed before its run began.
    EdgeMissing {
        /// Number of edges with such a run.
        measured: usize,
        /// Number of edges that should measure the repeat at the same time.
        edges: usize,
    },
    /// The run with this index measured the same repeat again later.
    MeasuredAgain(usize),
    /// The results are a copy of the results with this index, which belong to the same run.
    CopyOf(usize),
}

impl Exclusion {
    /// Returns the reason as text. `run_name` returns the name of a run from the run's index.
    pub fn describe(&self, run_name: impl Fn(usize) -> String) -> String {
        match self {
            Self::Unfinished(state) => state.to_string(),
            Self::ConcurrentRunUnfinished(other) => {
                format!("measured together with {}, which was not measured to its end", run_name(*other))
            }
            Self::EdgeMissing { measured, edges } => {
                format!("measured by only {measured} of {edges} edges")
            }
            Self::MeasuredAgain(later) => format!("measured again as {}", run_name(*later)),
            Self::CopyOf(original) => format!("a copy of {}", run_name(*original)),
        }
    }
}

/// Facts that decide whether a run counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Id of the run; `None` for results of other programs.
    pub id: Option<RunId>,
    /// Progress of the run; `None` if it is not recorded.
    pub state: Option<RunState>,
    /// Repeat that the run measured; `None` outside of experiments.
    pub repeat: Option<Repeat>,
    /// Number of edges that measure the repeat at the same time; `None` if it is not recorded.
    pub edges: Option<u32>,
    /// Start and end on the edge's wall clock; `None` if the start is not recorded. If the end is not recorded, the
    /// last known time stands for the end.
    pub times: Option<(WallTime, WallTime)>,
    /// Position in time: a later run has a larger number, such as the start in nanoseconds since the Unix epoch.
    pub sequence: i64,
    /// True if the command names the run. Such a run counts in any state.
    pub is_named: bool,
    /// Rank of the results. If there are several results of one run, the results with the lowest rank are used.
    pub rank: u8,
}

/// Repeat of a configuration, as one pipeline of one edge measured it. Several edges can measure the same repeat as
/// users of one cloud.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Repeat {
    experiment: String,
    configuration: Vec<(String, String)>,
    number: u32,
    edge: HostId,
    pipeline: String,
}

impl Repeat {
    /// Returns the repeat that a pipeline of an edge measured.
    pub fn new(position: &ExperimentPosition, edge: HostId, pipeline: &str) -> Self {
        let ExperimentPosition { id, configuration, repeat, .. } = position.clone();
        Self { experiment: id, configuration, number: repeat, edge, pipeline: pipeline.to_owned() }
    }

    /// Returns the experiment, the configuration and the number of the repeat. All edges that measure the repeat have
    /// these in common.
    fn position(&self) -> (&str, &[(String, String)], u32) {
        (&self.experiment, &self.configuration, self.number)
    }
}

impl Candidate {
    /// Returns the candidate of results that were read. Results outside of experiments have no state, because such runs
    /// are not repeated after a failure.
    pub fn from_results(run: &Loaded) -> Self {
        let record = &run.record;
        let position = record.experiment.as_ref();
        let started = record.started.and_then(|at| at.timestamp_nanos_opt());
        let ended = record.ended.and_then(|at| at.timestamp_nanos_opt());
        // The end is not recorded if the agent failed. The start of the last iteration is the last known time then, as
        // in the store.
        let last_start = || {
            let last_start = run.rows.iter().map(|row| row.at()).reduce(f64::max);
            last_start.filter(|at| *at > 0.0).map(|at| Span::from_seconds_f64(at).nanos())
        };
        let ended = ended.or_else(last_start);
        let times = started.map(|started| (started, ended.unwrap_or(started)));
        Self {
            id: record.run,
            state: position.map(|_| RunState::from_end_reason(Some(&record.reason))),
            repeat: position
                .zip(record.edge.id)
                .map(|(position, edge)| Repeat::new(position, edge, &record.name)),
            edges: position.and_then(|position| position.edges),
            times: times
                .map(|(start, end)| (WallTime::from_unix_nanos(start), WallTime::from_unix_nanos(end))),
            sequence: started.unwrap_or_default(),
            is_named: false,
            rank: 0,
        }
    }

    /// Returns whether two runs measured the same repeat at the same time, on two edges or with two pipelines.
    fn is_together_with(&self, other: &Self) -> bool {
        let repeats = self.repeat.as_ref().zip(other.repeat.as_ref());
        let is_same_repeat =
            repeats.is_some_and(|(repeat, other)| repeat != other && repeat.position() == other.position());
        let times = self.times.zip(other.times);
        is_same_repeat && times.is_some_and(|(times, other)| times.0 <= other.1 && other.0 <= times.1)
    }
}

/// Returns for each run the reason why it does not count; `None` if it counts.
pub fn exclusions(runs: &[Candidate]) -> Vec<Option<Exclusion>> {
    let unfinished = |run: &Candidate| {
        let state = run.state.as_ref().filter(|state| !run.is_named && !state.is_finished())?;
        Some(Exclusion::Unfinished(state.clone()))
    };
    let mut exclusions: Vec<Option<Exclusion>> = runs.iter().map(unfinished).collect();
    // After one of several concurrent runs ended early, the other runs had less competition than configured, so they do
    // not count either.
    let unfinished_runs: Vec<usize> = (0..runs.len()).filter(|index| exclusions[*index].is_some()).collect();
    exclude(runs, &mut exclusions, |run| {
        (!run.is_named).then_some(())?;
        let other = unfinished_runs.iter().find(|other| run.is_together_with(&runs[**other]))?;
        Some(Exclusion::ConcurrentRunUnfinished(*other))
    });
    // An edge that failed before its run began has no run, but the other edges had less competition all the same. The
    // times are not compared: edges with few iterations can end before the others begin.
    let included = runs.iter().zip(&exclusions).filter(|(_, exclusion)| exclusion.is_none());
    let repeats: Vec<&Repeat> = included.filter_map(|(run, _)| run.repeat.as_ref()).collect();
    exclude(runs, &mut exclusions, |run| {
        let (repeat, edges) = run.repeat.as_ref().zip(run.edges).filter(|_| !run.is_named)?;
        let same_repeat = repeats.iter().filter(|other| other.position() == repeat.position());
        let measured = same_repeat.map(|other| other.edge).collect::<HashSet<_>>().len();
        let edges = edges as usize;
        (measured < edges).then_some(Exclusion::EdgeMissing { measured, edges })
    });
    // Copies are excluded before repeats are compared: copies of one run belong to one repeat, and if the comparison of
    // repeats came first, the time would choose among the copies instead of the rank.
    let originals = best_runs(runs, &exclusions, |run| run.id, |index, run| (run.rank, index));
    exclude(runs, &mut exclusions, |run| Some(Exclusion::CopyOf(*originals.get(&run.id?)?)));
    let newest_runs = best_runs(
        runs,
        &exclusions,
        |run| run.repeat.as_ref(),
        |index, run| (-i128::from(run.sequence), index),
    );
    let measured_again = |run: &Candidate| {
        let newest = newest_runs.get(&run.repeat.as_ref()?)?;
        (!run.is_named).then_some(Exclusion::MeasuredAgain(*newest))
    };
    exclude(runs, &mut exclusions, measured_again);
    exclusions
}

/// Returns for each key, such as an id or a repeat, the index of the run that has this key and the smallest `order`.
/// Excluded runs are left out.
fn best_runs<'a, K: Eq + std::hash::Hash, O: Ord>(
    runs: &'a [Candidate],
    exclusions: &[Option<Exclusion>],
    key: impl Fn(&'a Candidate) -> Option<K>,
    order: impl Fn(usize, &Candidate) -> O,
) -> HashMap<K, usize> {
    let mut best_by_key = HashMap::new();
    for (index, run) in runs.iter().enumerate().filter(|(index, _)| exclusions[*index].is_none()) {
        let Some(key) = key(run) else { continue };
        let best = best_by_key.entry(key).or_insert(index);
        if order(index, run) < order(*best, &runs[*best]) {
            *best = index;
        }
    }
    best_by_key
}

/// Excludes runs for the reason that `reason` returns. If `reason` names the run itself as the run that replaces it,
/// the run still counts.
fn exclude(
    runs: &[Candidate],
    exclusions: &mut [Option<Exclusion>],
    reason: impl Fn(&Candidate) -> Option<Exclusion>,
) {
    for (index, (run, exclusion)) in runs.iter().zip(exclusions).enumerate() {
        let names_run_itself = |reason: &Exclusion| match reason {
            Exclusion::CopyOf(other) | Exclusion::MeasuredAgain(other) => *other == index,
            _ => false,
        };
        if exclusion.is_none() {
            *exclusion = reason(run).filter(|reason| !names_run_itself(reason));
        }
    }
}

#[cfg(test)]
mod tests;
