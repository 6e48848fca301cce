//! The resource of iterations.

mod schema;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_store::IterationFilter;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{Iteration, IterationList, IterationSummary};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded, path};
use crate::state::App;
use crate::view::runs::reject_deleted;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list)).routes(routes!(get))
}

/// Order of a list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Order {
    /// Order by increasing number.
    #[default]
    Number,
    /// The slowest successful iterations first.
    Slowest,
}

/// Query parameters of the list of iterations.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// Iterations after this number: `next` of the previous page.
    #[param(minimum = 0)]
    after: Option<u64>,
    /// Maximum number of iterations returned, 1 to 1,000; 100 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1_000, default = 100)]
    limit: Option<String>,
    /// `true` to list only failed iterations: those with the outcome `failed`, `lost` or `timeout`.
    unsuccessful: bool,
    /// `number` unless given; `slowest` cannot be combined with `after` or `unsuccessful`.
    #[param(inline)]
    order: Order,
}

/// Iterations by increasing number, or the slowest first. Iterations that retention deleted are missing.
#[utoipa::path(get, path = "/api/v1/runs/{run}/iterations", operation_id = "listIterations", tag = "iterations", params(("run" = i64, Path), Query), responses(
    (status = 200, body = IterationList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<IterationList>, WebError> {
    let number = path(number)?;
    let limit = parse_bounded("limit", query.limit.as_deref(), 100, 1..=1_000)?;
    app.store().run(number).await?.ok_or_else(|| WebError::no_run(number))?;
    if query.order == Order::Slowest {
        if query.after.is_some() || query.unsuccessful {
            let text = "query parameter order: slowest cannot be combined with after or unsuccessful";
            return Err(WebError::BadRequest(text.to_owned()));
        }
        let rows = app.store().slowest_iterations(number, limit).await?;
        return Ok(Json(IterationList {
            iterations: rows.iter().map(IterationSummary::from).collect(),
            next: None,
        }));
    }
    // Iterations that arrived late are stored although retention has deleted later numbers.
    let filter = IterationFilter { after: query.after.unwrap_or(0), limit, failed_only: query.unsuccessful };
    let rows = app.store().iterations(number, &filter).await?;
    // Whether more rows follow a full page is not known: the next page may be empty.
    let next = rows.last().filter(|_| rows.len() == limit as usize).map(|row| row.number);
    Ok(Json(IterationList { iterations: rows.iter().map(IterationSummary::from).collect(), next }))
}

/// One iteration with its tree. The status is 410 if retention deleted it, and 404 if it never existed.
#[utoipa::path(get, path = "/api/v1/runs/{run}/iterations/{iteration}", operation_id = "getIteration", tag = "iterations",
    params(("run" = i64, Path), ("iteration" = u64, Path)),
    responses(
        (status = 200, body = Iteration),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
async fn get(
    State(app): State<App>,
    numbers: Result<Path<(i64, u64)>, PathRejection>,
) -> Result<Json<Iteration>, WebError> {
    let (run, number) = path(numbers)?;
    if let Some(iteration) = app.store().iteration(run, number).await? {
        return Ok(Json(Iteration::try_from(&iteration)?));
    }
    let detail = app.store().run(run).await?.ok_or_else(|| WebError::no_run(run))?;
    reject_deleted(&detail.summary, number, app.aggregator.retention())?;
    Err(WebError::NotFound(format!("run {run} has no stored iteration {number}")))
}
