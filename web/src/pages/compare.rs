//! Page of a comparison: which configuration is faster, by how much, and whether that is more than chance.

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::HOST;
use axum::routing::get;
use peernet_analysis::compare::{MIN_BATCHES, MIN_VALUES};
use peernet_statistics::number::{self, NONE, count};
use peernet_store::ExperimentSummary;

use super::registration::{NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, page};
use crate::parameters::Parameters;
use crate::state::App;
use crate::view::chip::Chip;
use crate::view::compare::{
    Address, Axes, BoxRow, CompareSelection, Comparison, Configuration, DifferenceRow, Differences,
    Distributions, ExcludedRun, Lengths, MAX_EXPERIMENT_RUNS, ModelByPlace, OverTime, PairwiseRow,
    PayloadPlots, QualityPlot, RunMeans, Setting, StackRow, StageDifference, Table, UsersTable, answers,
    boxes, caveats, commands, distributions, lengths, load_comparison, measured_users, models_by_place,
    over_time, pairwise, payload, qualities, run_means, run_time_series, stacks, title, unknown_labels,
    users,
};

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/compare", get(show)),
    entry: Some(NavigationEntry { name: "Compare", address: "/compare", key: "c" }),
    topic: None,
};

/// Query parameter with the stage whose distributions are shown.
const STAGE: &str = "stage";
/// Query parameter with the run whose configuration is the baseline.
const BASELINE: &str = "baseline";
/// Number of experiments offered when nothing is selected.
const MAX_OFFERED: u32 = 50;
/// Maximum number of letters of a label that stays on one line.
const MAX_UNBROKEN_LETTERS: usize = 24;
/// Maximum number of excluded runs that are named.
const MAX_NAMED_EXCLUSIONS: usize = 8;

#[derive(Template)]
#[template(path = "pages/compare.html")]
struct Compare {
    shell: Shell,
    title: String,
    /// Name of the experiment, or the number of compared runs.
    crumb: String,
    facts: Vec<String>,
    /// Maximum number of compared runs, if the experiment has more runs.
    truncated_to: Option<u32>,
    left_out: Vec<ExcludedRun>,
    table: Table,
    /// Caveats about the means, each with its chip.
    caveats: Vec<(Chip, String)>,
    /// Names of the settings whose values differ, but are hashes, paths or long lists, which the table does not show.
    long_settings: String,
    /// Names of the configurations that are not ranked, because their model computes nothing.
    unranked: String,
    /// Remarks on samples without a score.
    unscored_remarks: Vec<String>,
    /// Name of the latency by which the configurations are compared.
    total: String,
    stacks: Vec<StackRow>,
    axes: Axes,
    /// The total of each configuration.
    boxes: Vec<BoxRow>,
    boxes_axes: Axes,
    /// Distributions of each run.
    distributions: Option<Distributions>,
    /// Each run over time.
    over_time: Option<OverTime>,
    /// Inference of each model that ran at several places, such as on board and in the cloud.
    models_by_place: Vec<ModelByPlace>,
    models_by_place_axes: Axes,
    baseline: Baseline,
    /// Settings that do not distinguish configurations.
    settings: Vec<Setting>,
    /// Names of the configurations.
    names: Vec<String>,
    payload: Vec<PayloadPlots>,
    /// Latency by length of the answer.
    lengths: Option<Lengths>,
    users: Option<UsersTable>,
    qualities: Vec<QualityPlot>,
    /// Commands that compare the runs by all their iterations.
    commands: Option<String>,
}

/// The configuration that others are compared with, and their differences from it.
struct Baseline {
    name: String,
    /// Name of each configuration; number of its first run, by which the configuration is selected; and `true` for the baseline.
    choices: Vec<(String, i64, bool)>,
    address: Address,
    others: Vec<OtherRow>,
    /// `true` if at least one difference has no interval.
    lacks_interval: bool,
}

/// Difference of a configuration from the baseline.
struct OtherRow {
    name: String,
    total: Option<DifferenceRow>,
    /// Differences between the single iterations of the configuration and of the baseline.
    pairs: Option<PairwiseRow>,
    stages: Vec<DifferenceRow>,
}

#[derive(Template)]
#[template(path = "pages/compare_empty.html")]
struct CompareEmpty {
    shell: Shell,
    experiments: Vec<ExperimentSummary>,
}

/// `GET /compare`.
async fn show(
    State(app): State<App>,
    headers: HeaderMap,
    Parameters(query): Parameters<Vec<(String, String)>>,
) -> Page {
    let (store, snapshot) = (app.store(), app.live_state());
    let shell = |title: &str| Shell::new(&app, &snapshot, "/compare", title);
    // `CompareSelection::parse` rejects unknown parameters, so `stage` and `baseline` are taken out before.
    let (selected_stage, query): (Vec<_>, Vec<_>) = query.into_iter().partition(|(name, _)| name == STAGE);
    let selected_stage =
        selected_stage.last().map(|(_, stage)| stage.as_str()).filter(|stage| !stage.is_empty());
    let (baseline, query): (Vec<_>, Vec<_>) = query.into_iter().partition(|(name, _)| name == BASELINE);
    let baseline = baseline.last().map(|(_, run)| run.as_str());
    let Some(selection) =
        CompareSelection::parse(&query, "runs or experiment, and optionally stage and baseline")?
    else {
        let experiments = store.experiments(MAX_OFFERED).await?;
        return page(&CompareEmpty { shell: shell("Compare"), experiments });
    };
    let comparison = load_comparison(store, &selection).await?;
    let distributions = distributions(&comparison, selected_stage)?;
    let baseline = comparison.baseline(baseline)?;
    let (means, time_series, answers, measured_users) = tokio::try_join!(
        run_means(store, &comparison),
        run_time_series(store, &comparison),
        answers(store, &comparison),
        measured_users(store, &comparison),
    )?;
    let dashboard_address = headers.get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let over_time = over_time(&comparison, &time_series);
    let lengths = lengths(&comparison, &answers);
    let users = users(&comparison, &measured_users);
    let compare =
        assemble(shell("Compare"), &comparison, (&means, baseline), distributions, dashboard_address);
    page(&Compare { over_time, lengths, users, ..compare })
}

/// Returns the page without `over_time`, `lengths` and `users`. The caller sets these fields.
fn assemble(
    shell: Shell,
    comparison: &Comparison,
    (means, baseline): (&RunMeans, Option<usize>),
    distributions: Option<Distributions>,
    dashboard_address: &str,
) -> Compare {
    let differences = Differences::of(comparison, means, baseline);
    let best = differences.ranking.as_ref().map(|ranking| ranking.best);
    let (stacks, axes) = stacks(comparison, best);
    let (boxes, boxes_axes) = boxes(comparison);
    let (models_by_place, models_by_place_axes) = models_by_place(comparison);
    let (runs, stored_runs) = (comparison.run_count(), comparison.runs().count());
    let crumb = match &comparison.experiment {
        Some((name, _)) => format!("experiment {name}"),
        None => number::counted(runs as u64, "run"),
    };
    let mut facts = common_pipeline(comparison);
    facts.push(number::counted(comparison.configurations.len() as u64, "configuration"));
    let run_count = number::counted(runs as u64, "run");
    facts.push(match stored_runs == runs {
        true => run_count,
        false => format!("{run_count}, stored as {}: one for each edge", count(stored_runs as u64)),
    });
    facts.push("successful iterations, warm-up left out".to_owned());
    let unranked: Vec<&str> =
        differences.unranked.iter().map(|index| comparison.configurations[*index].name.as_str()).collect();
    Compare {
        shell: Shell { title: format!("Compare {crumb}"), ..shell },
        title: title(comparison, &differences),
        crumb,
        facts,
        truncated_to: comparison.is_truncated.then_some(MAX_EXPERIMENT_RUNS),
        left_out: comparison.left_out.clone(),
        table: Table::of(comparison, &differences),
        caveats: caveats(comparison),
        long_settings: comparison.long_settings.join(", "),
        unranked: unranked.join("; "),
        unscored_remarks: unknown_labels(comparison),
        total: comparison.total_column.title().to_lowercase(),
        stacks,
        axes,
        boxes,
        boxes_axes,
        distributions,
        over_time: None,
        models_by_place,
        models_by_place_axes,
        baseline: Baseline::of(comparison, &differences),
        settings: comparison.settings.clone(),
        names: comparison.configurations.iter().map(|one| one.name.clone()).collect(),
        payload: payload(comparison),
        lengths: None,
        users: None,
        qualities: qualities(comparison),
        commands: commands(comparison, dashboard_address),
    }
}

impl Baseline {
    fn of(comparison: &Comparison, differences: &Differences) -> Self {
        let all = &comparison.configurations;
        let choice = |(index, one): (usize, &Configuration)| {
            Some((one.name.clone(), one.runs.first()?.number, index == differences.baseline))
        };
        let mut pairs = pairwise(comparison, differences).into_iter();
        let is_total = |stage: &StageDifference| stage.name == *differences.total_column.name();
        let mut other = |(index, stages): &(usize, Vec<StageDifference>)| {
            let rows = DifferenceRow::of_stages(stages);
            OtherRow {
                name: all[*index].name.clone(),
                total: stages.iter().position(is_total).map(|position| rows[position].clone()),
                pairs: pairs.next().flatten(),
                stages: rows,
            }
        };
        let has_difference =
            |stages: &[StageDifference]| stages.iter().any(|stage| stage.mean_difference.is_some());
        let others = differences.others.iter();
        let mean_differences =
            others.clone().flat_map(|(_, stages)| stages.iter().filter_map(|stage| stage.mean_difference));
        let rows = others
            .clone()
            // `other` is called for each configuration, because each call takes the next entry of `pairs`.
            .map(|one| (has_difference(&one.1), other(one)))
            .filter(|(has_difference, _)| *has_difference);
        let rows: Vec<OtherRow> = rows.map(|(_, row)| row).collect();
        Self {
            name: all.get(differences.baseline).map_or_else(String::new, |one| one.name.clone()),
            choices: all.iter().enumerate().filter_map(choice).collect(),
            address: Address::of(comparison),
            lacks_interval: mean_differences.into_iter().any(|difference| difference.interval.is_none()),
            others: rows,
        }
    }
}

/// Returns a list with the name of the pipeline if all runs are runs of one pipeline, else an empty list.
fn common_pipeline(comparison: &Comparison) -> Vec<String> {
    let mut pipelines: Vec<String> = comparison.runs().map(|run| run.pipeline.to_string()).collect();
    pipelines.dedup();
    if let [_] = pipelines.as_slice() { pipelines } else { Vec::new() }
}

#[cfg(test)]
pub(super) fn render_comparison(
    shell: Shell,
    comparison: &Comparison,
    means: &RunMeans,
    (selected_stage, baseline): (Option<&str>, Option<&str>),
) -> Result<String, crate::error::WebError> {
    let distributions = distributions(comparison, selected_stage)?;
    let over_time = over_time(comparison, &crate::view::compare::tests::run_time_series(comparison));
    let baseline = comparison.baseline(baseline)?;
    let compare = assemble(shell, comparison, (means, baseline), distributions, "localhost:8040");
    let lengths =
        lengths(comparison, &crate::view::compare::lengths::tests::answers_from_quantiles(comparison));
    let users = users(comparison, &crate::view::compare::tests::measured_users(comparison));
    Ok(Compare { over_time, lengths, users, ..compare }.render().expect("renders"))
}
