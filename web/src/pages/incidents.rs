//! What happened beside the measurements?

use askama::Template;
use axum::extract::State;
use serde::Deserialize;

use super::{Page, page};
use crate::parameters::Parameters;
use crate::state::App;
use crate::view::incidents::IncidentLine;
use crate::view::shell::{Place, Shell};

/// Incidents per page.
const PAGE: u32 = 100;

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
pub(crate) async fn show(State(app): State<App>, Parameters(query): Parameters<Query>) -> Page {
    let mut rows = app.store().incidents(PAGE + 1, query.before).await?;
    let more = rows.len() > PAGE as usize;
    rows.truncate(PAGE as usize);
    page(&Incidents {
        shell: Shell::new(&app, &app.picture(), Place::Incidents, "Incidents"),
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
