//! Page of all runs: the latency of each configuration.

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_statistics::number::count;
use peernet_store::RunFilter;
use serde::Deserialize;

use super::registration::{NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, page};
use crate::parameters::{self, Parameters};
use crate::state::App;
use crate::view::runs::RunLine;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/runs", get(show)),
    entry: Some(NavigationEntry { name: "Runs", address: "/runs", key: "r" }),
    topic: None,
};

/// Maximum number of runs on a page.
const MAX_ROWS: u32 = 50;

/// Query parameters.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// Name of the runs' pipeline.
    pipeline: Option<String>,
    /// Runs before this number.
    before: Option<i64>,
}

#[derive(Template)]
#[template(path = "pages/runs.html")]
struct Runs {
    shell: Shell,
    title: String,
    pipeline: Option<String>,
    /// `true` for a page after the first.
    is_later_page: bool,
    runs: Vec<RunLine>,
    /// Query string of the page with older runs; `None` on the last page.
    older: Option<String>,
}

/// `GET /runs`.
async fn show(State(app): State<App>, Parameters(query): Parameters<Query>) -> Page {
    let pipeline =
        query.pipeline.as_deref().map(|name| parameters::parse_slug("pipeline", name)).transpose()?;
    // One row more than the page shows tells whether there are older runs.
    let filter = RunFilter { pipeline, limit: MAX_ROWS + 1, before: query.before, ..RunFilter::default() };
    let mut runs = app.store().runs(&filter).await?;
    let has_more = runs.len() > MAX_ROWS as usize;
    runs.truncate(MAX_ROWS as usize);
    let older = runs.last().filter(|_| has_more).map(|last| {
        let name = query.pipeline.as_ref().map_or_else(String::new, |name| format!("&pipeline={name}"));
        format!("?before={}{name}", last.number)
    });
    // Runs are numbered from 1 and are not deleted, so the number of the newest run is the number of all runs.
    let newest = runs.first().map_or(0, |run| run.number).unsigned_abs();
    let title = match (runs.is_empty(), &query.pipeline, query.before) {
        (true, None, None) => "No run is stored yet".to_owned(),
        (true, Some(name), None) => format!("No run of {name} is stored"),
        (true, _, Some(_)) => "No older run is stored".to_owned(),
        (_, Some(name), _) => format!("Runs of {name}"),
        (_, None, Some(before)) => format!("Runs before #{before}"),
        (_, None, None) if newest == 1 => "1 run".to_owned(),
        (_, None, None) => format!("{} runs", count(newest)),
    };
    let window_title =
        query.pipeline.as_ref().map_or_else(|| "Runs".to_owned(), |name| format!("Runs of {name}"));
    let snapshot = app.live_state();
    page(&Runs {
        shell: Shell::new(&app, &snapshot, "/runs", window_title),
        title,
        is_later_page: query.before.is_some(),
        pipeline: query.pipeline,
        runs: runs.iter().map(|run| RunLine::new(run, &snapshot, app.zone)).collect(),
        older,
    })
}
