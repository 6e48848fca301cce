//! Page of all links: whether one-way delays between the hosts can be trusted.

use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_aggregator::LiveState;
use peernet_store::LinkRow;

use super::registration::{LiveTopic, NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::link::list::{LinkLine, PastLine, title};
use crate::view::list_limits;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/links", get(show)),
    entry: Some(NavigationEntry { name: "Links", address: "/links", key: "l" }),
    topic: Some(LiveTopic {
        pattern: TOPIC,
        update: |app, snapshot, _| Box::pin(ready(update(app, snapshot))),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "links";

#[derive(Template)]
#[template(path = "pages/links.html", blocks = ["title", "list"])]
struct Links {
    shell: Shell,
    title: String,
    lines: Vec<LinkLine>,
    /// Sentence shown if the list is truncated.
    truncation_note: Option<String>,
    /// Links that are stored but not in the live state.
    past_links: Vec<PastLine>,
    /// Sentence shown if the list of past links is truncated.
    past_truncation_note: Option<String>,
}

/// `GET /links`.
async fn show(State(app): State<App>) -> Page {
    let stored = AppState::empty_if_store_is_closed(app.store().links().await)?;
    page(&links(&app, &app.live_state(), &stored))
}

/// Renders the live parts of the page.
pub(super) fn update(app: &AppState, snapshot: &LiveState) -> Result<Update, WebError> {
    // The list of past links is no live part, so an update needs no stored links.
    let page = links(app, snapshot, &[]);
    let parts = vec![("title", page.as_title().render()?), ("list", page.as_list().render()?)];
    Ok(Update::new(page.shell.title, parts))
}

fn links(app: &AppState, snapshot: &LiveState, stored: &[LinkRow]) -> Links {
    let mut past_links = PastLine::all(stored, snapshot, app.zone);
    let past_truncation_note = list_limits::truncation_note(list_limits::MAX_IN_LIST, past_links.len());
    past_links.truncate(list_limits::MAX_IN_LIST);
    Links {
        shell: Shell::new(app, snapshot, "/links", "Links").live(TOPIC),
        title: title(snapshot),
        lines: LinkLine::first(list_limits::MAX_IN_LIST, snapshot, app.zone),
        truncation_note: list_limits::truncation_note(list_limits::MAX_IN_LIST, snapshot.links.len()),
        past_links,
        past_truncation_note,
    }
}
