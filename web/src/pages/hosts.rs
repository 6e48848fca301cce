//! Page of all hosts: their load, their clocks, and their events that are not stored yet.

use std::collections::HashSet;
use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_aggregator::LiveState;
use peernet_statistics::number::{count, counted};
use peernet_store::HostRow;

use super::registration::{LiveTopic, NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::events::EventLine;
use crate::view::hosts::{HostLine, RefusedLine};
use crate::view::{list_limits, startup};
use crate::zone::ZonedTime;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/hosts", get(show)),
    entry: Some(NavigationEntry { name: "Hosts", address: "/hosts", key: "h" }),
    topic: Some(LiveTopic {
        pattern: TOPIC,
        update: |app, snapshot, _| Box::pin(ready(update(app, snapshot))),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "hosts";

#[derive(Template)]
#[template(path = "pages/hosts.html", blocks = ["title", "list", "events"])]
struct Hosts {
    shell: Shell,
    title: String,
    /// The title in the past tense. The page shows it while the page is disconnected from the aggregator.
    past_title: String,
    hosts: Vec<HostLine>,
    /// Hosts that said goodbye.
    ended_hosts: Vec<HostLine>,
    events: Vec<EventLine>,
    /// Sentence shown if the list is truncated.
    truncation_note: Option<String>,
    /// Sentence about hosts that connected before, shown while no host reports.
    absent_hosts: Option<String>,
    /// Hosts whose connections were refused recently.
    refused: Vec<RefusedLine>,
    /// Hosts that are stored but not in the live state: name and time of the last report.
    past_hosts: Vec<(String, ZonedTime)>,
    /// Sentence shown if the list of past hosts is truncated.
    past_truncation_note: Option<String>,
}

/// `GET /hosts`.
async fn show(State(app): State<App>) -> Page {
    let stored = AppState::empty_if_store_is_closed(app.store().hosts().await)?;
    page(&hosts(&app, &app.live_state(), &stored))
}

/// Renders the live parts of the page.
pub(super) fn update(app: &AppState, snapshot: &LiveState) -> Result<Update, WebError> {
    // The list of past hosts is no live part, so an update needs no stored hosts.
    let page = hosts(app, snapshot, &[]);
    let parts = vec![
        ("title", page.as_title().render()?),
        ("list", page.as_list().render()?),
        ("events", page.as_events().render()?),
    ];
    Ok(Update::new(page.shell.title, parts))
}

fn hosts(app: &AppState, snapshot: &LiveState, stored: &[HostRow]) -> Hosts {
    let connected = snapshot.hosts.iter().filter(|host| host.connected).count();
    let title = match snapshot.hosts.len() {
        0 if snapshot.absent > 0 => startup::WAITING.to_owned(),
        0 => "No host has reported yet".to_owned(),
        1 => format!("1 host, {}connected", if connected == 1 { "" } else { "not " }),
        all if all == connected => format!("{}, all connected", counted(all as u64, "host")),
        all => format!("{} of {} hosts are connected", count(connected as u64), count(all as u64)),
    };
    let past_title = match snapshot.hosts.len() {
        0 => "No host had reported".to_owned(),
        1 => format!("{connected} of 1 host was connected"),
        all => format!("{} of {} hosts were connected", count(connected as u64), count(all as u64)),
    };
    let live: HashSet<_> = snapshot.hosts.iter().map(|host| host.id).collect();
    let past_hosts: Vec<&HostRow> = stored.iter().filter(|row| !live.contains(&row.id)).collect();
    let (current_hosts, ended_hosts) = HostLine::current_and_ended(
        list_limits::MAX_IN_LIST,
        snapshot,
        app.clock.identity(),
        app.zone,
        &app.warn,
    );
    Hosts {
        shell: Shell::new(app, snapshot, "/hosts", "Hosts").live(TOPIC),
        title,
        past_title,
        hosts: current_hosts,
        ended_hosts,
        events: snapshot
            .hosts
            .iter()
            .take(list_limits::MAX_IN_LIST)
            .map(|host| EventLine::new(host))
            .collect(),
        truncation_note: list_limits::truncation_note(list_limits::MAX_IN_LIST, snapshot.hosts.len()),
        absent_hosts: startup::absent_hosts_sentence(snapshot),
        refused: RefusedLine::all(snapshot, app.zone),
        past_truncation_note: list_limits::truncation_note(list_limits::MAX_IN_LIST, past_hosts.len()),
        past_hosts: past_hosts
            .iter()
            .take(list_limits::MAX_IN_LIST)
            .map(|row| (row.name.to_string(), app.zone.moment(row.last_seen)))
            .collect(),
    }
}
