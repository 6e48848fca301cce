//! Can I trust one-way delays between these hosts?

use askama::Template;
use axum::extract::State;
use peernet_aggregator::Picture;
use peernet_store::LinkRow;

use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::cut;
use crate::view::link::list::{LinkLine, PastLine, title};
use crate::view::shell::{Place, Shell};

/// Topic of the live stream.
pub(crate) const TOPIC: &str = "links";

#[derive(Template)]
#[template(path = "pages/links.html", blocks = ["title", "list"])]
struct Links {
    shell: Shell,
    title: String,
    lines: Vec<LinkLine>,
    /// Said where not all of them are shown.
    cut: Option<String>,
    /// Links that are stored but not in the live picture.
    past: Vec<PastLine>,
}

/// `GET /links`.
pub(crate) async fn show(State(app): State<App>) -> Page {
    let stored = AppState::beside_live(app.store().links().await)?;
    page(&links(&app, &app.picture(), &stored))
}

/// What of the page changed.
pub(crate) fn update(app: &AppState, picture: &Picture) -> Result<Update, WebError> {
    let page = links(app, picture, &[]);
    let parts = vec![("title", page.as_title().render()?), ("list", page.as_list().render()?)];
    Ok(Update::new(page.shell.title, parts))
}

fn links(app: &AppState, picture: &Picture, stored: &[LinkRow]) -> Links {
    let mut past = PastLine::all(stored, picture, app.zone);
    past.truncate(cut::LIST);
    Links {
        shell: Shell::new(app, picture, Place::Links, "Links").live(TOPIC),
        title: title(picture),
        lines: LinkLine::first(cut::LIST, picture, app.zone),
        cut: cut::words(cut::LIST, picture.links.len()),
        past,
    }
}
