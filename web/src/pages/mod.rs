//! The dashboard: one file per page, its template beside it. A page is complete when it arrives; what of it is
//! live is a block of its template, sent again by the live stream.

pub(crate) mod compare;
pub(crate) mod error;
pub(crate) mod host;
pub(crate) mod hosts;
pub(crate) mod incidents;
pub(crate) mod iteration;
pub(crate) mod link;
pub(crate) mod links;
pub(crate) mod overview;
pub(crate) mod pipeline;
pub(crate) mod pipelines;
pub(crate) mod run;
pub(crate) mod runs;
#[cfg(test)]
mod tests;

use askama::Template;
use axum::Router;
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::response::Html;
use axum::routing::get;
use serde::Serialize;

use crate::error::WebError;
use crate::state::App;
use crate::view::chart::{Mark, Obstacles};

/// A rendered page.
pub(crate) type Page = Result<Html<String>, WebError>;

pub(crate) fn routes() -> Router<App> {
    Router::new()
        .route("/", get(overview::show))
        .route("/pipelines", get(pipelines::show))
        .route("/pipelines/{host}/{pipeline}", get(pipeline::show))
        .route("/runs", get(runs::show))
        .route("/runs/{run}", get(run::show))
        .route("/runs/{run}/iterations/{iteration}", get(iteration::show))
        .route("/compare", get(compare::show))
        .route("/links", get(links::show))
        .route("/links/{link}", get(link::show))
        .route("/hosts", get(hosts::show))
        .route("/hosts/{host}", get(host::show))
        .route("/incidents", get(incidents::show))
}

fn page(template: &impl Template) -> Page {
    Ok(Html(template.render()?))
}

/// The values of a path; nonsense in it is an address that does not exist.
fn path<T>(path: Result<Path<T>, PathRejection>) -> Result<T, WebError> {
    path.map(|Path(value)| value).map_err(|rejection| WebError::NotFound(rejection.body_text()))
}

/// What of a live page changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Update {
    /// Changes when the page must be fetched again, because its parts are others.
    pub layout: String,
    /// Title of the window.
    pub title: String,
    /// Contents of elements by their id.
    pub parts: Vec<(&'static str, String)>,
    /// Incidents to mark on the time axes.
    pub marks: Vec<Mark>,
    /// By chart, why the upward and the downward throughput have no line.
    pub obstacles: Vec<(String, Obstacles)>,
}

impl Update {
    /// An update of a page without charts.
    fn new(title: String, parts: Vec<(&'static str, String)>) -> Self {
        Self { layout: String::new(), title, parts, marks: Vec::new(), obstacles: Vec::new() }
    }
}
