//! What happened beside the measurements?

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use serde::Deserialize;

use super::kind::{NavigationEntry, PageKind};
use super::shell::Shell;
use super::{Page, page};
use crate::parameters::Parameters;
use crate::state::App;
use crate::view::incidents::IncidentLine;

/// This page.
pub(super) const PAGE: PageKind = PageKind {
    routes: || Router::new().route("/incidents", get(show)),
    entry: Some(NavigationEntry { name: "Incidents", address: "/incidents", key: "i" }),
    topic: None,
};

/// Incidents per page.
const ROWS: u32 = 100;

/// What the address may ask for.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// Only incidents before this id.
    before: Option<i64>,
}

#[derive(Template)]
#[template(path = "pages/incidents.html")]
struct Incidents {
    shell: Shell,
    title: &'static str,
    lines: Vec<IncidentLine>,
    /// Whether any of them belongs to a run.
    runs: bool,
    older: Option<i64>,
}

/// `GET /incidents`.
async fn show(State(app): State<App>, Parameters(query): Parameters<Query>) -> Page {
    let mut rows = app.store().incidents(ROWS + 1, query.before).await?;
    let more = rows.len() > ROWS as usize;
    rows.truncate(ROWS as usize);
    page(&Incidents {
        shell: Shell::new(&app, &app.picture(), "/incidents", "Incidents"),
        title: if rows.is_empty() {
            "Nothing out of the ordinary has happened"
        } else {
            "What happened beside the measurements"
        },
        older: rows.last().filter(|_| more).map(|last| last.id),
        runs: rows.iter().any(|row| row.run.is_some()),
        lines: IncidentLine::all(&rows, app.zone),
    })
}
