//! The dashboard: one file per page, with its template next to it.
//!
//! A page is complete when it is loaded. The live parts of a page are blocks of the page's template. The live stream sends
//! a part again when the part has changed.
//!
//! This file registers the pages. Each page is named here twice, as a module and in [`PAGES`], and nowhere else in the
//! program.

mod compare;
mod error;
mod host;
mod hosts;
mod incidents;
mod iteration;
mod link;
mod links;
mod overview;
mod pipeline;
mod pipelines;
mod registration;
mod run;
mod runs;
mod shell;
#[cfg(test)]
mod tests;

use askama::Template;
use axum::Router;
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::response::Html;
use serde::Serialize;

use self::registration::{LiveTopic, NavigationEntry, PageRegistration};
use crate::error::WebError;
use crate::state::App;
use crate::view::chart::{IncidentMark, Obstacles};

pub(crate) use self::error::render as render_problem;
pub(crate) use self::registration::RequestedTopic;

/// All pages. The navigation and the list of topics have their entries in this order.
static PAGES: &[PageRegistration] = &[
    overview::PAGE,
    pipelines::PAGE,
    runs::PAGE,
    compare::PAGE,
    links::PAGE,
    hosts::PAGE,
    incidents::PAGE,
    pipeline::PAGE,
    run::PAGE,
    iteration::PAGE,
    link::PAGE,
    host::PAGE,
];

/// A rendered page.
pub(crate) type Page = Result<Html<String>, WebError>;

pub(crate) fn routes() -> Router<App> {
    PAGES.iter().fold(Router::new(), |router, page| router.merge((page.routes)()))
}

/// Returns the entries of the navigation.
fn navigation_entries() -> impl Iterator<Item = &'static NavigationEntry> {
    PAGES.iter().filter_map(|page| page.entry.as_ref())
}

fn live_topics() -> impl Iterator<Item = &'static LiveTopic> {
    PAGES.iter().filter_map(|page| page.topic.as_ref())
}

/// Returns the patterns of the topics of live pages, such as `host/HOST`.
pub(crate) fn topic_patterns() -> impl Iterator<Item = &'static str> {
    live_topics().map(|topic| topic.pattern)
}

/// Returns the topic of a live page from its text, such as `host/cam-1`; `None` if no page has such a topic.
pub(crate) fn topic(text: &str) -> Option<RequestedTopic> {
    RequestedTopic::find(text, live_topics())
}

fn page(template: &impl Template) -> Page {
    Ok(Html(template.render()?))
}

/// Returns the parameters of a path.
///
/// # Errors
/// `NotFound` when a parameter is invalid: no page has such an address.
fn path<T>(path: Result<Path<T>, PathRejection>) -> Result<T, WebError> {
    path.map(|Path(value)| value).map_err(|rejection| WebError::NotFound(rejection.body_text()))
}

/// New contents of the live parts of a page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Update {
    /// Identifier of the layout. When it changes, the script reloads the page, because the page has other parts.
    pub layout: String,
    /// Title of the browser's window.
    pub title: String,
    /// Id of each part, and its new HTML. The live stream removes the parts that have not changed since it sent them.
    pub parts: Vec<(&'static str, String)>,
    /// Incidents to mark on the time axes.
    pub marks: Vec<IncidentMark>,
    /// Key of each chart, and the reasons why the chart's upward and downward throughput have no line.
    pub obstacles: Vec<(String, Obstacles)>,
}

impl Update {
    /// Returns an update of a page without charts.
    fn new(title: String, parts: Vec<(&'static str, String)>) -> Self {
        Self { layout: String::new(), title, parts, marks: Vec::new(), obstacles: Vec::new() }
    }
}
