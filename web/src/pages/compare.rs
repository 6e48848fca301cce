//! Which configuration is faster, by how much, and is that more than chance?

use askama::Template;
use axum::extract::State;
use peernet_aggregator::{ExperimentSummary, StageCourse, Store};
use peernet_logger::{Name, stage};

use super::{Page, page};
use crate::api::parameters::Parameters;
use crate::error::WebError;
use crate::numbers::NONE;
use crate::state::App;
use crate::svg::{Axis, Scatter};
use crate::view::compare::{
    Changed, Comparison, MOST_RUNS, Pair, StackRow, Table, Which, accuracy, difference, gather, pairs,
    payload, stacks, title, too_short,
};
use crate::view::counted;
use crate::view::shell::{Place, Shell};

/// Experiments that are offered when nothing was chosen.
const OFFERED: u32 = 50;
/// Most buckets that a run's course is read in.
const BUCKETS: usize = 120;

#[derive(Template)]
#[template(path = "pages/compare.html")]
struct Compare {
    shell: Shell,
    title: String,
    facts: Vec<String>,
    cut: Option<u32>,
    table: Table,
    stacks: Vec<StackRow>,
    axis: Axis,
    pairs: Vec<Pair>,
    pairs_axis: Axis,
    letters: Option<(String, String)>,
    changes: Vec<Changed>,
    /// Why a difference has no interval.
    too_short: Option<String>,
    payload: Option<(Scatter, Vec<String>)>,
    accuracy: Option<Scatter>,
}

#[derive(Template)]
#[template(path = "pages/compare_empty.html")]
struct Empty {
    shell: Shell,
    experiments: Vec<ExperimentSummary>,
}

/// `GET /compare`.
pub(crate) async fn show(
    State(app): State<App>,
    Parameters(query): Parameters<Vec<(String, String)>>,
) -> Page {
    let (store, picture) = (app.store(), app.picture());
    let shell = |title: &str| Shell::new(&app, &picture, Place::Runs, title);
    let Some(which) = Which::of(&query)? else {
        let experiments = store.experiments(OFFERED).await?;
        return page(&Empty { shell: shell("Compare"), experiments });
    };
    let comparison = gather(store, &which).await?;
    let courses = courses(store, &comparison).await?;
    page(&assemble(shell("Compare"), &comparison, courses.as_ref()))
}

/// What each run of a configuration was over time.
pub(crate) type Courses = Vec<Vec<StageCourse>>;

/// The courses of both configurations where there are two.
pub(crate) async fn courses(
    store: &Store,
    comparison: &Comparison,
) -> Result<Option<(Courses, Courses)>, WebError> {
    let [first, second] = comparison.configurations.as_slice() else { return Ok(None) };
    let names: Vec<Name> = [stage::TOTAL, stage::STAGES_TOTAL].into_iter().chain(stage::ORDER).collect();
    let mut both = [Vec::new(), Vec::new()];
    for (one, read) in [first, second].into_iter().zip(&mut both) {
        for run in &one.runs {
            read.push(store.course(run.number, &names, BUCKETS).await?);
        }
    }
    let [first, second] = both;
    Ok(Some((first, second)))
}

fn assemble(shell: Shell, comparison: &Comparison, courses: Option<&(Courses, Courses)>) -> Compare {
    let two = match (comparison.configurations.as_slice(), courses) {
        ([first, second], Some((a, b))) => difference((first, a), (second, b)),
        _ => Vec::new(),
    };
    let too_short = match (comparison.configurations.as_slice(), courses) {
        ([first, second], Some((a, b))) => too_short((first, a), (second, b), &two),
        _ => None,
    };
    let total =
        two.first().filter(|(name, ..)| *name == stage::TOTAL).and_then(|(_, found, _)| found.as_ref());
    let (stacks, axis) = stacks(comparison);
    let (pairs, pairs_axis) = pairs(comparison);
    let runs = comparison.runs().count();
    let letters = || comparison.configurations.iter().map(|one| one.letter.clone());
    let mut facts: Vec<String> =
        comparison.experiment.iter().map(|(name, _)| format!("experiment {name}")).collect();
    facts.push(counted(comparison.configurations.len(), "configuration", "configurations"));
    facts.push(counted(runs, "run", "runs"));
    facts.push("successful iterations, warm-up left out".to_owned());
    Compare {
        shell,
        title: title(comparison, total),
        facts,
        cut: comparison.cut.then_some(MOST_RUNS),
        table: Table::of(comparison),
        stacks,
        axis,
        pairs,
        pairs_axis,
        letters: letters().next().zip(letters().nth(1)).filter(|_| !two.is_empty()),
        changes: two.into_iter().map(|(.., changed)| changed).collect(),
        too_short,
        payload: payload(comparison),
        accuracy: accuracy(comparison),
    }
}

#[cfg(test)]
pub(super) fn rendered(
    shell: Shell,
    comparison: &Comparison,
    courses: Option<&(Courses, Courses)>,
) -> String {
    assemble(shell, comparison, courses).render().expect("renders")
}
