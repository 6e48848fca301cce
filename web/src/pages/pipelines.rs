//! Page of all pipelines of all hosts.

use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_aggregator::{LiveState, PipelineSnapshot};
use peernet_statistics::number::{count, counted};
use peernet_stream::PipelineState;

use super::registration::{LiveTopic, NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::pipeline_table::{PipelineRow, PipelineTable};
use crate::view::place;
use crate::view::{list_limits, startup};

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/pipelines", get(show)),
    entry: Some(NavigationEntry { name: "Pipelines", address: "/pipelines", key: "p" }),
    topic: Some(LiveTopic {
        pattern: TOPIC,
        update: |app, snapshot, _| Box::pin(ready(update(app, snapshot))),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "pipelines";

#[derive(Template)]
#[template(path = "pages/pipelines.html", blocks = ["title", "list"])]
struct Pipelines {
    shell: Shell,
    title: String,
    /// The title in the past tense. The page shows it while the page is disconnected from the aggregator.
    past_title: String,
    lines: Vec<Line>,
    /// Sentence shown if the list is truncated.
    truncation_note: Option<String>,
}

struct Line {
    figures: PipelineRow,
    host: String,
    route: String,
    model: String,
    load: String,
    /// State of the pipeline, with the reason if it does not run.
    state: String,
    run: Option<i64>,
}

fn state(pipeline: &PipelineSnapshot) -> String {
    let state = &pipeline.state;
    let away = (*state == PipelineState::Away).then_some("its host is not connected");
    match state.reason().or(away) {
        Some(reason) => format!("{}: {reason}", state.name()),
        None => state.name().to_owned(),
    }
}

/// `GET /pipelines`.
async fn show(State(app): State<App>) -> Page {
    page(&pipelines(&app, &app.live_state()))
}

/// Renders the live parts of the page.
pub(super) fn update(app: &AppState, snapshot: &LiveState) -> Result<Update, WebError> {
    let page = pipelines(app, snapshot);
    let parts = vec![("title", page.as_title().render()?), ("list", page.as_list().render()?)];
    Ok(Update::new(page.shell.title, parts))
}

fn pipelines(app: &AppState, snapshot: &LiveState) -> Pipelines {
    let all: Vec<&PipelineSnapshot> = snapshot.pipelines.iter().map(|pipeline| &**pipeline).collect();
    let running = all.iter().filter(|pipeline| pipeline.state == PipelineState::Running).count();
    let title = match all.len() {
        0 if startup::is_waiting_for_agents(snapshot, app.started_at) => startup::WAITING.to_owned(),
        0 => "No pipeline has reported yet".to_owned(),
        all => format!("{}, {} running", counted(all as u64, "pipeline"), count(running as u64)),
    };
    let past_title = match all.len() {
        0 => "No pipeline had reported".to_owned(),
        all => format!("{} of {} pipelines ran", count(running as u64), count(all as u64)),
    };
    let shown = &all[..all.len().min(list_limits::MAX_IN_LIST)];
    let rows = PipelineTable::new(shown).rows;
    let lines = shown.iter().zip(rows).map(|(pipeline, figures)| Line {
        figures,
        host: pipeline.host_name.to_string(),
        route: place::route(pipeline.host_name.as_str(), &pipeline.placement),
        model: place::model(&pipeline.placement),
        load: pipeline.load.clone(),
        state: state(pipeline),
        run: pipeline.run_number,
    });
    Pipelines {
        shell: Shell::new(app, snapshot, "/pipelines", "Pipelines").live(TOPIC),
        title,
        past_title,
        lines: lines.collect(),
        truncation_note: list_limits::truncation_note(list_limits::MAX_IN_LIST, all.len()),
    }
}
