//! What happened beside the measurements.

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use utoipa::IntoParams;

use super::schema::{Incident, IncidentList};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, bounded};
use crate::state::App;

/// Which incidents.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub(crate) struct Query {
    /// At most so many, 1 to 1,000; 100 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1_000, default = 100)]
    limit: Option<String>,
    /// Only incidents before this id: `next` of the page before.
    before: Option<i64>,
}

/// Incidents, newest first.
#[utoipa::path(get, path = "/api/v1/incidents", operation_id = "listIncidents", tag = "incidents", params(Query), responses(
    (status = 200, body = IncidentList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn list(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<IncidentList>, WebError> {
    let limit = bounded("limit", query.limit.as_deref(), 100, 1..=1_000)?;
    let rows = app.store().incidents(limit, query.before).await?;
    let next = rows.last().filter(|_| rows.len() == limit as usize).map(|row| row.id);
    Ok(Json(IncidentList { incidents: rows.iter().map(Incident::from).collect(), next }))
}
