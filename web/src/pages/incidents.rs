//! Page of incidents, such as lost connections, clock steps, gaps and failed pipelines.

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_store::{AggregatorIncidentKind, IncidentFilter};
use peernet_stream::IncidentKind;
use serde::Deserialize;

use super::registration::{NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, page};
use crate::parameters::Parameters;
use crate::state::App;
use crate::view::incidents::IncidentLine;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/incidents", get(show)),
    entry: Some(NavigationEntry { name: "Incidents", address: "/incidents", key: "i" }),
    topic: None,
};

/// Kinds of incidents of hosts and of the aggregator.
const KINDS: [&str; 11] = [
    IncidentKind::Disconnected.name(),
    IncidentKind::Connected.name(),
    IncidentKind::Refused.name(),
    IncidentKind::ModelLoaded.name(),
    IncidentKind::ModelUnloaded.name(),
    IncidentKind::ClockStep.name(),
    IncidentKind::Gap.name(),
    IncidentKind::PipelineFailed.name(),
    IncidentKind::Control.name(),
    AggregatorIncidentKind::Retention.name(),
    AggregatorIncidentKind::Storage.name(),
];

/// Maximum number of incidents on a page.
const MAX_ROWS: u32 = 100;

/// Query parameters.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// Incidents before this id.
    before: Option<i64>,
    /// Kind of the incidents; empty for all.
    kind: Option<String>,
    /// Name of the host that reported the incidents; empty for all.
    host: Option<String>,
}

#[derive(Template)]
#[template(path = "pages/incidents.html")]
struct Incidents {
    shell: Shell,
    title: &'static str,
    lines: Vec<IncidentLine>,
    /// `true` if any incident belongs to a run.
    has_runs: bool,
    /// Value of `before` for the page with older incidents; `None` on the last page.
    older: Option<i64>,
    /// Kinds that can be selected; `true` for the selected one.
    kinds: Vec<(&'static str, bool)>,
    /// Names of hosts that can be selected; `true` for the selected one.
    hosts: Vec<(String, bool)>,
    filter: IncidentFilter,
}

/// `GET /incidents`.
async fn show(State(app): State<App>, Parameters(query): Parameters<Query>) -> Page {
    let non_empty = |value: Option<String>| value.filter(|value| !value.is_empty());
    let Query { before, kind, host } = query;
    // One row more than the page shows tells whether there are older incidents.
    let filter = IncidentFilter { limit: MAX_ROWS + 1, before, kind: non_empty(kind), host: non_empty(host) };
    let (mut rows, hosts) = tokio::try_join!(app.store().incidents(&filter), app.store().hosts())?;
    let is_filtered = filter.kind.is_some() || filter.host.is_some();
    let has_more = rows.len() > MAX_ROWS as usize;
    rows.truncate(MAX_ROWS as usize);
    page(&Incidents {
        shell: Shell::new(&app, &app.live_state(), "/incidents", "Incidents"),
        title: match (rows.is_empty(), is_filtered) {
            (true, true) => "No such incident is stored",
            (true, false) => "No incident is stored",
            (false, _) => "Incidents",
        },
        kinds: KINDS.map(|kind| (kind, filter.kind.as_deref() == Some(kind))).to_vec(),
        hosts: hosts
            .iter()
            .map(|host| (host.name.to_string(), filter.host.as_deref() == Some(host.name.as_str())))
            .collect(),
        older: rows.last().filter(|_| has_more).map(|last| last.id),
        has_runs: rows.iter().any(|row| row.run.is_some()),
        lines: IncidentLine::all(&rows, app.zone),
        filter,
    })
}
