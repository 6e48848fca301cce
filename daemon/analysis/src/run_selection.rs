//! Choice of the runs that count: runs that were measured to their end, each repeat of a configuration once, and runs that are named
//! explicitly.

use std::collections::HashMap;
use std::fmt;

use peernet_logger::{HostId, RunId};
use peernet_stream::{EndReason, ExperimentPlace};

use crate::loaded::Loaded;

/// Progress of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunState {
    /// It has not begun.
    Pending,
    /// It has no end: it is in progress, or its program was killed.
    Open,
    /// It was measured to its end.
    Finished,
    /// Somebody ended it.
    Interrupted,
    /// It could not be measured to its end, for this reason if one is known.
    Failed(Option<String>),
}

impl RunState {
    /// Returns the state of a run that began, by the reason for its end; `None` for one without an end.
    pub fn from_end_reason(reason: Option<&EndReason>) -> Self {
        match reason {
            None | Some(EndReason::Unknown) => Self::Open,
            Some(EndReason::Finished) => Self::Finished,
            Some(EndReason::Stopped) => Self::Interrupted,
            Some(EndReason::Failed(reason)) => Self::Failed(Some(reason.clone())),
        }
    }

    /// Returns whether the run counts, as far as its progress decides.
    pub const fn is_finished(&self) -> bool {
        matches!(self, Self::Finished)
    }

    /// Returns the state in words, for readers who do not know whether a program still works on the run.
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

/// Reason why a run does not count. Other runs are named by their indexes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Exclusion {
    /// It was not measured to its end.
    Unfinished(RunState),
    /// The same repeat was measured again.
    MeasuredAgain(usize),
    /// These are other results of the same run.
    CopyOf(usize),
}

impl Exclusion {
    /// Returns the reason in words; `name` names another run.
    pub fn describe(&self, name: impl Fn(usize) -> String) -> String {
        match self {
            Self::Unfinished(state) => state.to_string(),
            Self::MeasuredAgain(by) => format!("measured again as {}", name(*by)),
            Self::CopyOf(of) => format!("a copy of {}", name(*of)),
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
    /// Position in time: of two runs the later one has the larger number.
    pub sequence: i64,
    /// `true` if it is named explicitly, so that its progress does not matter.
    pub is_named: bool,
    /// Rank of the results. If there are several results of a run, those with the lowest rank count.
    pub rank: u8,
}

/// Repeat of a configuration, as one edge measured it: several users of one run are several edges.
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
    pub fn new(place: &ExperimentPlace, edge: HostId, pipeline: &str) -> Self {
        let ExperimentPlace { id, configuration, repeat, .. } = place.clone();
        Self { experiment: id, configuration, number: repeat, edge, pipeline: pipeline.to_owned() }
    }
}

impl Candidate {
    /// Returns the candidate of results that were read. Results outside of experiments have no state, because such runs are not repeated
    /// after a failure.
    pub fn from_results(run: &Loaded) -> Self {
        let record = &run.record;
        let place = record.experiment.as_ref();
        Self {
            id: record.run,
            state: place.map(|_| RunState::from_end_reason(Some(&record.reason))),
            repeat: place.zip(record.edge.id).map(|(place, edge)| Repeat::new(place, edge, &record.name)),
            sequence: record.started.and_then(|at| at.timestamp_nanos_opt()).unwrap_or_default(),
            is_named: false,
            rank: 0,
        }
    }
}

/// Returns for each run the reason why it does not count; `None` if it counts.
pub fn exclusions(runs: &[Candidate]) -> Vec<Option<Exclusion>> {
    let unfinished = |run: &Candidate| {
        let state = run.state.as_ref().filter(|state| !run.is_named && !state.is_finished())?;
        Some(Exclusion::Unfinished(state.clone()))
    };
    let mut found: Vec<Option<Exclusion>> = runs.iter().map(unfinished).collect();
    // Copies are excluded before repeats are compared, because the results of one run are also of one repeat: the rank chooses among
    // them, not the time.
    let by_id = best(runs, &found, |run| run.id, |at, run| (!run.is_named, run.rank, at));
    exclude(runs, &mut found, |run| Some(Exclusion::CopyOf(*by_id.get(&run.id?)?)));
    let newest = best(runs, &found, |run| run.repeat.as_ref(), |at, run| (-i128::from(run.sequence), at));
    let again = |run: &Candidate| {
        let by = newest.get(&run.repeat.as_ref()?)?;
        (!run.is_named).then_some(Exclusion::MeasuredAgain(*by))
    };
    exclude(runs, &mut found, again);
    found
}

/// Returns for each key the index of the run with the smallest order, among the runs that are not excluded in `found`.
fn best<'a, K: Eq + std::hash::Hash, O: Ord>(
    runs: &'a [Candidate],
    found: &[Option<Exclusion>],
    key: impl Fn(&'a Candidate) -> Option<K>,
    order: impl Fn(usize, &Candidate) -> O,
) -> HashMap<K, usize> {
    let mut all = HashMap::new();
    for (at, run) in runs.iter().enumerate().filter(|(at, _)| found[*at].is_none()) {
        let Some(key) = key(run) else { continue };
        let best = all.entry(key).or_insert(at);
        if order(at, run) < order(*best, &runs[*best]) {
            *best = at;
        }
    }
    all
}

/// Excludes runs that count so far in favour of others.
fn exclude(
    runs: &[Candidate],
    found: &mut [Option<Exclusion>],
    why: impl Fn(&Candidate) -> Option<Exclusion>,
) {
    for (at, (run, excluded)) in runs.iter().zip(found).enumerate() {
        let in_favour_of_itself = |why: &Exclusion| matches!(why, Exclusion::CopyOf(by) | Exclusion::MeasuredAgain(by) if *by == at);
        if excluded.is_none() {
            *excluded = why(run).filter(|why| !in_favour_of_itself(why));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(repeat: u32, edge: HostId, state: RunState, sequence: i64) -> Candidate {
        let place =
            ExperimentPlace { name: "x".to_owned(), id: "x1".to_owned(), configuration: Vec::new(), repeat };
        Candidate {
            id: Some(RunId::random()),
            state: Some(state),
            repeat: Some(Repeat::new(&place, edge, "line")),
            sequence,
            is_named: false,
            rank: 0,
        }
    }

    #[test]
    fn finished_repeat_counts_once_per_edge() {
        let (edge, other) = (HostId::random(), HostId::random());
        let runs = [
            run(0, edge, RunState::Finished, 1),
            run(1, edge, RunState::Interrupted, 2),
            run(1, edge, RunState::Finished, 3),
            run(0, other, RunState::Finished, 4),
            run(0, edge, RunState::Finished, 5),
            run(2, edge, RunState::Open, 6),
        ];
        let unfinished = |state| Some(Exclusion::Unfinished(state));
        let expected = [
            Some(Exclusion::MeasuredAgain(4)),
            unfinished(RunState::Interrupted),
            None,
            None,
            None,
            unfinished(RunState::Open),
        ];
        assert_eq!(exclusions(&runs), expected);
    }

    #[test]
    fn named_run_counts_in_any_state() {
        let edge = HostId::random();
        let mut runs = [
            run(0, edge, RunState::Failed(None), 1),
            run(1, edge, RunState::Finished, 2),
            run(1, edge, RunState::Finished, 3),
        ];
        runs.iter_mut().take(2).for_each(|run| run.is_named = true);
        assert_eq!(exclusions(&runs), [None, None, None]);
    }

    #[test]
    fn one_of_several_copies_counts() {
        let first = run(0, HostId::random(), RunState::Finished, 1);
        let runs = [Candidate { rank: 1, ..first.clone() }, first.clone(), first.clone()];
        let copy = Some(Exclusion::CopyOf(1));
        assert_eq!(exclusions(&runs), [copy.clone(), None, copy]);
        let named = [first.clone(), Candidate { is_named: true, rank: 1, ..first.clone() }];
        assert_eq!(exclusions(&named), [Some(Exclusion::CopyOf(1)), None]);
        let unknown = Candidate { id: None, repeat: None, state: None, ..first };
        assert_eq!(exclusions(&[unknown.clone(), unknown]), [None, None], "nothing is known of either");
    }
}
