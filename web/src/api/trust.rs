//! Whether a run can be published.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};

use super::run::no_run;
use super::schema::Trust;
use crate::error::{ProblemDetails, WebError};
use crate::parameters::path;
use crate::state::App;
use crate::view::trust;

/// "Can I publish this run?": what was seen before, during and after it, in sentences, the most harmful first.
#[utoipa::path(get, path = "/api/v1/runs/{run}/trust", operation_id = "getRunTrust", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = Trust),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn one(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<Trust>, WebError> {
    let number = path(number)?;
    let store = app.store();
    let run = store.run(number).await?.ok_or_else(|| no_run(number))?;
    let (known, courses) = tokio::try_join!(store.statistics_of(number), trust::courses(store, number))?;
    Ok(Json(Trust::from(&trust::report(&run, &known, &courses))))
}
