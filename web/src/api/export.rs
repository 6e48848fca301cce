//! Export of a run as a table.

use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::stream;
use peernet_analysis::rows::Row;
use peernet_results::Header;
use peernet_store::{RunSummary, Store};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, path};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(table))
}

/// The form of a table.
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
    /// `csv`, the only one so far.
    #[param(inline)]
    format: Format,
}

/// All iterations of a run as a table, in the format of the `data.csv` that a run writes (docs/results.md): one row each, the published
/// columns first, in seconds, bytes and bits per second. `peernet compare` and `peernet plot` read it. For a run that has not ended, the
/// table holds the iterations stored at the time of the request.
#[utoipa::path(get, path = "/api/v1/runs/{run}/export", operation_id = "exportRun", tag = "runs", params(("run" = i64, Path), Query), responses(
    (status = 200, body = String, content_type = "text/csv"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn table(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(Query { format: Format::Csv }): Parameters<Query>,
) -> Result<Response, WebError> {
    let number = path(number)?;
    let run = app.store().run(number).await?.ok_or_else(|| WebError::no_run(number))?;
    let name = format!("{}-{number}.csv", run.summary.pipeline);
    // The next chunk is read only when the reader has taken the one before, so that a long run never lies in memory as a whole. The first
    // chunk holds the names of the columns, for which all iterations of the run are scanned.
    let chunks = stream::try_unfold(None, move |begun| {
        let (app, run) = (app.clone(), run.summary.clone());
        async move {
            let mut text = Vec::new();
            let Some(Begun { header, after, through }) = begun else {
                let (header, through) = columns(app.store(), &run).await?;
                header.write_header(&mut text);
                return Ok(Some((Bytes::from(text), Some(Begun { header, after: 0, through }))));
            };
            if after >= through {
                return Ok::<_, WebError>(None);
            }
            let Some((last, iterations)) = app.store().full_iterations(&run, after).await? else {
                return Ok(None);
            };
            for iteration in iterations.iter().filter(|iteration| iteration.number <= through) {
                header.write_row(&mut text, &Row::from_iteration(iteration));
            }
            Ok(Some((Bytes::from(text), Some(Begun { header, after: last, through }))))
        }
    });
    let head = [
        (CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    Ok((head, Body::from_stream(chunks)).into_response())
}

/// State of a table whose header was sent.
struct Begun {
    header: Header,
    /// Number of the last iteration that was sent, and of the last one to send.
    after: u64,
    through: u64,
}

/// Returns the columns that a run needs, and the number of its last iteration.
async fn columns(store: &Store, run: &RunSummary) -> Result<(Header, u64), WebError> {
    let (mut header, mut through) = (Header::default(), 0);
    while let Some((last, firsts)) = store.iterations_by_shape(run, through).await? {
        firsts.iter().for_each(|iteration| header.add(&Row::from_iteration(iteration)));
        through = last;
    }
    Ok((header, through))
}
