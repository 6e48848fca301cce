//! The resource of hosts.

mod schema;

use std::collections::HashSet;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{Host, HostList, RefusedHost};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::path;
use crate::state::{App, AppState};
use crate::view::clock_fault::FaultyClocks;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list)).routes(routes!(get))
}

/// All hosts that report or are stored, by name, and hosts whose connections were refused.
#[utoipa::path(get, path = "/api/v1/hosts", operation_id = "listHosts", tag = "hosts", responses(
    (status = 200, body = HostList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(State(app): State<App>) -> Result<Json<HostList>, WebError> {
    let snapshot = app.live_state();
    let FaultyClocks(clock_faults) = FaultyClocks::of(&snapshot);
    let refused = snapshot.refused.iter().map(RefusedHost::from).collect();
    Ok(Json(HostList { hosts: all_hosts(&app).await?, clock_faults, refused }))
}

/// One host, by name or id.
#[utoipa::path(get, path = "/api/v1/hosts/{host}", operation_id = "getHost", tag = "hosts",
    params(("host" = String, Path, description = "name or id")),
    responses(
        (status = 200, body = Host),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
async fn get(
    State(app): State<App>,
    host: Result<Path<String>, PathRejection>,
) -> Result<Json<Host>, WebError> {
    let name = path(host)?;
    let host = all_hosts(&app).await?.into_iter().find(|host| host.name == name || host.id == name);
    host.map(Json)
        .ok_or_else(|| WebError::NotFound(format!("no host {name} has ever reported to this aggregator")))
}

/// Returns the live hosts, and the stored hosts that are not live, by name.
async fn all_hosts(app: &AppState) -> Result<Vec<Host>, WebError> {
    // The store is read before the live state, so that a host that reports for the first time in between is in the live state.
    let stored = app.store().hosts().await?;
    let snapshot = app.live_state();
    let mut hosts: Vec<Host> = snapshot.hosts.iter().map(|host| Host::from(&**host)).collect();
    let live: HashSet<_> = snapshot.hosts.iter().map(|host| host.id).collect();
    let past = stored.iter().filter(|row| !live.contains(&row.id));
    hosts.extend(past.map(Host::from));
    hosts.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(hosts)
}
