//! Export of a run as a table.

use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::{TryStreamExt, stream};
use peernet_analysis::rows::Row;
use peernet_results::Header;
use peernet_store::{RunSummary, Store};
use peernet_stream::Iteration;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, path};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(export))
}

/// File format of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Format {
    /// Comma-separated values (RFC 4180): the format of a run's `data.csv`.
    #[default]
    Csv,
}

/// Query parameters of the export.
#[derive(Clone, Copy, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// File format; only `csv`.
    #[param(inline)]
    format: Format,
}

/// All iterations of a run as a table, one row each, in the format of the `data.csv` of a result folder (docs/results.md).
/// Columns of the paper's program come first. Values are in seconds, bytes and bits per second. `peernet compare` and `peernet plot`
/// read the table. For a run that has not ended, it holds the iterations that were stored at the time of the request.
#[utoipa::path(get, path = "/api/v1/runs/{run}/export", operation_id = "exportRun", tag = "runs", params(("run" = i64, Path), Query), responses(
    (status = 200, body = String, content_type = "text/csv"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn export(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(Query { format: Format::Csv }): Parameters<Query>,
) -> Result<Response, WebError> {
    let number = path(number)?;
    let run = app.store().run(number).await?.ok_or_else(|| WebError::no_run(number))?;
    let name = format!("{}-{number}.csv", run.summary.pipeline);
    // This part is read before the answer begins, so that a store that cannot be read gives an error and no empty table.
    let mut first_of_shapes = app.store().iterations_by_shape(&run.summary, 0).await?;
    let failing_app = app.clone();
    // A chunk is read from the store only when the client has taken the previous chunk, so that a long run is never in memory as a whole.
    // The first chunk is the header row. All iterations are scanned before it, because each iteration may add a column.
    let chunks = stream::try_unfold(None, move |progress| {
        let (app, run, first_of_shapes) = (app.clone(), run.summary.clone(), first_of_shapes.take());
        async move {
            let mut text = Vec::new();
            let Some(ExportProgress { header, after, last_number }) = progress else {
                let (header, last_number) = scan_columns(app.store(), &run, first_of_shapes).await?;
                header.write_header(&mut text);
                return Ok(Some((Bytes::from(text), Some(ExportProgress { header, after: 0, last_number }))));
            };
            if after >= last_number {
                return Ok::<_, WebError>(None);
            }
            let Some((last, iterations)) = app.store().full_iterations(&run, after).await? else {
                return Ok(None);
            };
            for iteration in iterations.iter().filter(|iteration| iteration.number <= last_number) {
                header.write_row(&mut text, &Row::from_iteration(iteration));
            }
            Ok(Some((Bytes::from(text), Some(ExportProgress { header, after: last, last_number }))))
        }
    });
    // The status has been sent, so the client only sees that the body is incomplete. `to_problem` logs the error.
    let chunks = chunks.inspect_err(move |error| {
        error.to_problem(&failing_app);
    });
    let headers = [
        (CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    Ok((headers, Body::from_stream(chunks)).into_response())
}

/// Progress of an export whose header row was sent.
struct ExportProgress {
    header: Header,
    /// Number of the last iteration that was sent.
    after: u64,
    /// Number of the last iteration to send. Later iterations may have columns that the header lacks.
    last_number: u64,
}

/// Returns the columns of all iterations of a run, and the number of its last iteration. `first_of_shapes` is the
/// store's answer for the beginning of the run.
async fn scan_columns(
    store: &Store,
    run: &RunSummary,
    mut first_of_shapes: Option<(u64, Vec<Iteration>)>,
) -> Result<(Header, u64), WebError> {
    let (mut header, mut last_number) = (Header::default(), 0);
    while let Some((last, iterations)) = first_of_shapes {
        iterations.iter().for_each(|iteration| header.add(&Row::from_iteration(iteration)));
        last_number = last;
        first_of_shapes = store.iterations_by_shape(run, last_number).await?;
    }
    Ok((header, last_number))
}
