//! `GET /api/v1/incidents`: occurrences beside the measurements, such as a lost connection or a clock step.

use axum::Json;
use axum::extract::State;
use peernet_store::{IncidentFilter, IncidentRow};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::schema::time;
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list))
}

/// Query parameters of the list of incidents.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// Maximum number of incidents returned, 1 to 1,000; 100 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1_000, default = 100)]
    limit: Option<String>,
    /// Incidents before this id: `next` of the previous page.
    before: Option<i64>,
    /// Kind of the incidents.
    kind: Option<String>,
    /// Name of the host that reported the incidents.
    host: Option<String>,
}

/// Incidents, newest first.
#[utoipa::path(get, path = "/api/v1/incidents", operation_id = "listIncidents", tag = "incidents", params(Query), responses(
    (status = 200, body = IncidentList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<IncidentList>, WebError> {
    let limit = parse_bounded("limit", query.limit.as_deref(), 100, 1..=1_000)?;
    let Query { before, kind, host, .. } = query;
    let rows = app.store().incidents(&IncidentFilter { limit, before, kind, host }).await?;
    // Whether more rows follow a full page is not known: the next page may be empty.
    let next = rows.last().filter(|_| rows.len() == limit as usize).map(|row| row.id);
    Ok(Json(IncidentList { incidents: rows.iter().map(Incident::from).collect(), next }))
}

/// Incidents, newest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct IncidentList {
    pub incidents: Vec<Incident>,
    /// `before` of the next page; null on the last.
    pub next: Option<i64>,
}

/// An occurrence beside the measurements, such as a lost connection or a clock step.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Incident {
    pub id: i64,
    /// Time of the incident, on the reporting host's wall clock.
    pub at: String,
    /// Kind of incident. Of a host: `disconnected`, `connected`, `refused`, `model-loaded`, `model-unloaded`, `clock-step`, `gap`,
    /// `pipeline-failed` or `control`; of the aggregator: `clock-step`, `retention` or `storage`.
    pub kind: String,
    /// Name of the reporting host; null for an incident of the aggregator.
    pub host: Option<String>,
    pub pipeline: Option<String>,
    pub run: Option<i64>,
    /// Name of the other host concerned.
    pub peer: Option<String>,
    pub text: String,
}

impl From<&IncidentRow> for Incident {
    fn from(row: &IncidentRow) -> Self {
        Self {
            id: row.id,
            at: time(row.at),
            kind: row.kind.clone(),
            host: row.host_name.as_ref().map(ToString::to_string),
            pipeline: row.pipeline.clone(),
            run: row.run,
            peer: row.peer.clone(),
            text: row.text.clone(),
        }
    }
}
