//! The resource of links and their clocks.

mod clock;
mod connections;
mod probing;
mod schema;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_clock::{Span, WallTime};
use peernet_store::LinkKey;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{Link, LinkList, LinkSeries};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded, parse_time, path};
use crate::state::{App, AppState};
use crate::view::link::{Subject, canonical, find, is_live, no_link};

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list)).routes(routes!(get)).routes(routes!(clock))
}

/// All links that report or are stored, by edge, cloud and network.
#[utoipa::path(get, path = "/api/v1/links", operation_id = "listLinks", tag = "links", responses(
    (status = 200, body = LinkList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(State(app): State<App>) -> Result<Json<LinkList>, WebError> {
    Ok(Json(LinkList { links: all_links(&app).await? }))
}

/// One link, by the names of its edge, its cloud and its network.
#[utoipa::path(get, path = "/api/v1/links/{link}", operation_id = "getLink", tag = "links",
    params(("link" = String, Path, description = "`EDGE~CLOUD`, or `EDGE~CLOUD~NETWORK`")),
    responses(
        (status = 200, body = Link),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
async fn get(
    State(app): State<App>,
    link: Result<Path<String>, PathRejection>,
) -> Result<Json<Link>, WebError> {
    let link_name = canonical(path(link)?);
    let link = all_links(&app).await?.into_iter().find(|link| link.name == link_name);
    link.map(Json).ok_or_else(|| no_link(&link_name))
}

/// Query parameters of the clock relation over time.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct ClockQuery {
    /// Start of the time range, RFC 3339, on the edge's wall clock; ten minutes before `to` unless given.
    #[param(format = DateTime)]
    from: Option<String>,
    /// End of the time range; time of the newest sample unless given.
    #[param(format = DateTime)]
    to: Option<String>,
    /// Maximum number of buckets, 1 to 2,000; 600 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 2_000, default = 600)]
    points: Option<String>,
}

/// A link's clock relation over time, and its network statistics.
#[utoipa::path(get, path = "/api/v1/links/{link}/clock", operation_id = "getLinkClock", tag = "links",
    params(("link" = String, Path, description = "`EDGE~CLOUD`, or `EDGE~CLOUD~NETWORK`"), ClockQuery),
    responses(
        (status = 200, body = LinkSeries),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
async fn clock(
    State(app): State<App>,
    link: Result<Path<String>, PathRejection>,
    Parameters(query): Parameters<ClockQuery>,
) -> Result<Json<LinkSeries>, WebError> {
    let link_name = canonical(path(link)?);
    let points = parse_bounded("points", query.points.as_deref(), 600, 1..=2_000)?;
    let (key, end) = find_key(&app, &link_name).await?;
    let to = query.to.as_deref().map(|text| parse_time("to", text)).transpose()?.unwrap_or(end);
    let from = query.from.as_deref().map(|text| parse_time("from", text)).transpose()?;
    let from = from.unwrap_or(to - Span::from_seconds(600));
    if from >= to {
        return Err(WebError::BadRequest(
            "query parameter from: the time is not before the time of the parameter to".to_owned(),
        ));
    }
    Ok(Json(LinkSeries::from(&app.store().clock_series(&key, from, to, points).await?)))
}

/// Returns the key of a link and the time of its newest sample.
async fn find_key(app: &AppState, link_name: &str) -> Result<(LinkKey, WallTime), WebError> {
    if let Some(link) = find(&app.live_state(), link_name) {
        let subject = Subject::live(link);
        return Ok((subject.key, subject.end));
    }
    let rows = app.store().links().await?;
    let past_link = rows.iter().map(Subject::past).find(|link| link.name() == link_name);
    past_link.map(|link| (link.key, link.end)).ok_or_else(|| no_link(link_name))
}

/// Returns the live links, and the stored links that are not live.
async fn all_links(app: &AppState) -> Result<Vec<Link>, WebError> {
    // The store is read before the live state, so that a link that is reported for the first time in between is in the live
    // state.
    let stored = app.store().links().await?;
    let snapshot = app.live_state();
    let mut links: Vec<Link> = snapshot.links.iter().map(|link| Link::from(&**link)).collect();
    for row in stored.iter().filter(|row| !is_live(&snapshot, row)) {
        let assumptions = app.store().link_assumptions(&row.key()).await?;
        links.push(Link::past(row, assumptions.as_ref()));
    }
    links.sort_by(|a, b| (&a.edge, &a.cloud, &a.network).cmp(&(&b.edge, &b.cloud, &b.network)));
    Ok(links)
}
