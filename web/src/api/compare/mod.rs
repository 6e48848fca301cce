//! Comparisons of runs, and experiments.

mod schema;

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{Comparison, Experiment, ExperimentList};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded};
use crate::state::App;
use crate::view::compare::{CompareSelection, Differences, load_comparison, run_means};

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(experiments)).routes(routes!(compare))
}

/// Query parameters of a comparison: runs or an experiment.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
struct CompareQuery {
    /// Numbers of runs, separated by commas, at most 12; each run is a separate configuration.
    #[allow(dead_code, reason = "describes the parameter")]
    #[param(pattern = "^[0-9]+(,[0-9]+){0,11}$")]
    runs: Option<String>,
    /// Id of an experiment. Compares all of its runs that were measured to their end, at most 200. If a repeat was measured more than
    /// once, one of its runs is compared. Repeats of a configuration are combined.
    #[allow(dead_code, reason = "describes the parameter")]
    experiment: Option<String>,
    /// Number of a compared run, whose configuration is the baseline. By default, the configuration with the lowest mean of `total` is the
    /// baseline.
    #[allow(dead_code, reason = "describes the parameter")]
    #[param(value_type = Option<i64>)]
    baseline: Option<String>,
}

/// Comparison of runs. Means and standard deviations over several runs are exact. Quantiles are computed over all runs of a
/// configuration together, within 1 %. The differences of the means to the baseline have a 95 % interval (Welch, from the means of at
/// most 30 batches of each run).
#[utoipa::path(get, path = "/api/v1/compare", operation_id = "compareRuns", tag = "runs", params(CompareQuery), responses(
    (status = 200, body = Comparison),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn compare(
    State(app): State<App>,
    Parameters(query): Parameters<Vec<(String, String)>>,
) -> Result<Json<Comparison>, WebError> {
    let (baseline, query): (Vec<_>, Vec<_>) = query.into_iter().partition(|(name, _)| name == "baseline");
    let selection = CompareSelection::parse(&query, "runs or experiment, and optionally baseline")?;
    let selection = selection.ok_or_else(|| {
        WebError::BadRequest(
            "query parameter runs: give numbers of runs, or an experiment instead".to_owned(),
        )
    })?;
    let comparison = load_comparison(app.store(), &selection).await?;
    let baseline = comparison.baseline(baseline.last().map(|(_, run)| run.as_str()))?;
    let means = run_means(app.store(), &comparison).await?;
    let differences = Differences::of(&comparison, &means, baseline);
    Ok(Json(Comparison::new(&comparison, &differences)))
}

/// Query parameters of the list of experiments.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct ExperimentsQuery {
    /// Maximum number of experiments returned, 1 to 1,000; 50 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1_000, default = 50)]
    limit: Option<String>,
}

/// Experiments, the one with the newest run first.
#[utoipa::path(get, path = "/api/v1/experiments", operation_id = "listExperiments", tag = "runs", params(ExperimentsQuery), responses(
    (status = 200, body = ExperimentList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn experiments(
    State(app): State<App>,
    Parameters(query): Parameters<ExperimentsQuery>,
) -> Result<Json<ExperimentList>, WebError> {
    let limit = parse_bounded("limit", query.limit.as_deref(), 50, 1..=1_000)?;
    let summaries = app.store().experiments(limit).await?;
    Ok(Json(ExperimentList { experiments: summaries.iter().map(Experiment::from).collect() }))
}
