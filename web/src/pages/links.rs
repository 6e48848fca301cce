//! Page of all links: whether one-way delays between the hosts can be trusted.

use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_aggregator::LiveState;
use peernet_store::LinkRow;

use super::kind::{LiveTopic, NavigationEntry, PageKind};
use super::shell::Shell;
use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::cut;
use crate::view::link::list::{LinkLine, PastLine, title};

/// Registration of this page.
pub(super) const PAGE: PageKind = PageKind {
    routes: || Router::new().route("/links", get(show)),
    entry: Some(NavigationEntry { name: "Links", address: "/links", key: "l" }),
    topic: Some(LiveTopic { form: TOPIC, update: |app, picture, _| Box::pin(ready(update(app, picture))) }),
};

/// Name of its topic of the live stream.
const TOPIC: &str = "links";

#[derive(Template)]
#[template(path = "pages/links.html", blocks = ["title", "list"])]
struct Links {
    shell: Shell,
    title: String,
    lines: Vec<LinkLine>,
    /// Sentence shown where the list is cut.
    cut: Option<String>,
    /// Links that are stored but not in the live picture.
    past: Vec<PastLine>,
}

/// `GET /links`.
async fn show(State(app): State<App>) -> Page {
    let stored = AppState::beside_live(app.store().links().await)?;
    page(&links(&app, &app.picture(), &stored))
}

/// Renders the changed parts of the page.
pub(super) fn update(app: &AppState, picture: &LiveState) -> Result<Update, WebError> {
    let page = links(app, picture, &[]);
    let parts = vec![("title", page.as_title().render()?), ("list", page.as_list().render()?)];
    Ok(Update::new(page.shell.title, parts))
}

fn links(app: &AppState, picture: &LiveState, stored: &[LinkRow]) -> Links {
    let mut past = PastLine::all(stored, picture, app.zone);
    past.truncate(cut::LIST);
    Links {
        shell: Shell::new(app, picture, "/links", "Links").live(TOPIC),
        title: title(picture),
        lines: LinkLine::first(cut::LIST, picture, app.zone),
        cut: cut::words(cut::LIST, picture.links.len()),
        past,
    }
}
