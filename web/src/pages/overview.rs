//! Overview: the health of the system, and where the time goes at present.

use std::collections::HashSet;

use askama::Template;
use axum::Router;
use axum::extract::State;
use axum::routing::get;
use peernet_aggregator::{LiveState, PipelineSnapshot};
use peernet_statistics::number::counted;
use peernet_store::IncidentRow;
use peernet_stream::PipelineState;

use super::registration::{LiveTopic, NavigationEntry, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::chart::{ChartCard, IncidentMark};
use crate::view::data::JsonBlock;
use crate::view::health::Health;
use crate::view::hosts::{HostLine, RefusedLine};
use crate::view::incidents::IncidentLine;
use crate::view::list_limits;
use crate::view::pipeline_table::PipelineTable;
use crate::view::startup;
use crate::zone::ZonedTime;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/", get(show)),
    entry: Some(NavigationEntry { name: "Overview", address: "/", key: "o" }),
    topic: Some(LiveTopic { pattern: TOPIC, update: |app, snapshot, _| Box::pin(update(app, snapshot)) }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "overview";

#[derive(Template)]
#[template(path = "pages/overview.html", blocks = ["health", "now", "nowtable", "hosts", "incidents"])]
pub(super) struct Overview {
    shell: Shell,
    layout: String,
    health: Health,
    now: PipelineTable,
    charts: Vec<ChartCard>,
    hosts: Vec<HostLine>,
    /// Hosts that said goodbye.
    ended_hosts: Vec<HostLine>,
    /// Beginning of a sentence about pipelines that are not shown because their hosts said goodbye.
    ended_pipelines_note: Option<String>,
    /// Sentences shown if the lists of pipelines and of hosts are truncated.
    truncation_note: [Option<String>; 2],
    /// `Err` holds the id under which the failure was logged.
    incidents: Result<Vec<IncidentLine>, String>,
    data: JsonBlock,
}

#[derive(Template)]
#[template(path = "pages/overview_empty.html", blocks = ["seen"])]
pub(super) struct EmptyOverview {
    shell: Shell,
    layout: String,
    /// Address at which the aggregator listens for events.
    listening: String,
    /// Time at which the server started.
    since: ZonedTime,
    refused: Vec<RefusedLine>,
    title: &'static str,
    /// Sentence about hosts that connected before. It replaces the instructions for a first host.
    absent_hosts: Option<String>,
}

/// `GET /`.
async fn show(State(app): State<App>) -> Page {
    let snapshot = app.live_state();
    if snapshot.hosts.is_empty() && snapshot.pipelines.is_empty() {
        return page(&empty_overview(&app, &snapshot));
    }
    let incidents = incidents(&app).await;
    page(&overview(&app, &snapshot, incidents)?)
}

/// Renders the live parts of the page.
pub(super) async fn update(app: &AppState, snapshot: &LiveState) -> Result<Update, WebError> {
    if snapshot.hosts.is_empty() && snapshot.pipelines.is_empty() {
        let page = empty_overview(app, snapshot);
        let parts = vec![("seen", page.as_seen().render()?)];
        return Ok(Update { layout: page.layout, ..Update::new(page.shell.title, parts) });
    }
    let incidents = incidents(app).await;
    let marks = incidents.as_ref().map(|rows| IncidentMark::all(rows)).unwrap_or_default();
    let page = overview(app, snapshot, incidents)?;
    let parts = vec![
        ("health", page.as_health().render()?),
        ("now", page.as_now().render()?),
        ("nowtable", page.as_nowtable().render()?),
        ("hosts", page.as_hosts().render()?),
        ("incidents", page.as_incidents().render()?),
    ];
    let obstacles = page.charts.iter().map(ChartCard::obstacles).collect();
    Ok(Update { layout: page.layout, marks, obstacles, ..Update::new(page.shell.title, parts) })
}

/// The newest incidents, or the id of the logged error.
type Incidents = Result<Vec<IncidentRow>, String>;

/// Returns the newest incidents, or the id of the logged error. An error of the store does not fail the page: only the panel of
/// incidents shows the error.
async fn incidents(app: &AppState) -> Incidents {
    let rows = app.shown_incidents().await;
    rows.map_err(|error| WebError::from(error).to_problem(app).id().unwrap_or_default().to_owned())
}

pub(super) fn empty_overview(app: &AppState, snapshot: &LiveState) -> EmptyOverview {
    let absent_hosts = startup::absent_hosts_sentence(snapshot);
    let title = if absent_hosts.is_some() { startup::WAITING } else { "No host has reported yet" };
    EmptyOverview {
        shell: Shell::new(app, snapshot, "/", title).live(TOPIC),
        title,
        absent_hosts,
        layout: "empty".to_owned(),
        listening: snapshot.listening.clone(),
        since: app.zone.moment(app.started_at),
        refused: RefusedLine::all(snapshot, app.zone),
    }
}

/// Maximum number of pipelines that are shown if the hosts of all pipelines have ended: one row of charts.
const MAX_ENDED_PIPELINES: usize = 3;

/// Pipelines of the overview.
struct ShownPipelines<'a> {
    /// The pipelines to show, running pipelines first. Pipelines of hosts that have ended are shown only if there are no others.
    pipelines: Vec<&'a PipelineSnapshot>,
    /// Number of pipelines of hosts that have not ended.
    current_count: usize,
    /// Number of pipelines of hosts that have ended and that are not shown.
    hidden_ended_count: usize,
}

impl<'a> ShownPipelines<'a> {
    fn of(snapshot: &'a LiveState) -> Self {
        let ended_host_ids: HashSet<_> =
            snapshot.hosts.iter().filter(|host| host.has_left).map(|host| host.id).collect();
        let all = snapshot.pipelines.iter().map(|one| &**one);
        let (mut ended, mut pipelines): (Vec<_>, Vec<_>) =
            all.partition(|one| ended_host_ids.contains(&one.host));
        let (current_count, all_ended) = (pipelines.len(), ended.len());
        pipelines.sort_by_key(|one| one.state != PipelineState::Running);
        pipelines.truncate(list_limits::MAX_ON_OVERVIEW);
        if pipelines.is_empty() {
            ended.truncate(MAX_ENDED_PIPELINES);
            return Self { hidden_ended_count: all_ended - ended.len(), pipelines: ended, current_count };
        }
        Self { pipelines, current_count, hidden_ended_count: all_ended }
    }

    /// Returns the beginning of a sentence about the pipelines of ended hosts that are not shown;
    /// `None` if there are none.
    fn ended_pipelines_note(&self) -> Option<String> {
        let verb = if self.hidden_ended_count == 1 { "is" } else { "are" };
        let pipelines = counted(self.hidden_ended_count as u64, "pipeline");
        (self.hidden_ended_count > 0).then(|| format!("{pipelines} of hosts that have ended {verb}"))
    }
}

pub(super) fn overview(
    app: &AppState,
    snapshot: &LiveState,
    incidents: Incidents,
) -> Result<Overview, WebError> {
    let health = Health::of(snapshot, app.zone, app.started_at, &app.warn);
    let shown = ShownPipelines::of(snapshot);
    let pipelines = &shown.pipelines;
    let (hosts, ended_hosts) = HostLine::current_and_ended(
        list_limits::MAX_ON_OVERVIEW,
        snapshot,
        app.clock.identity(),
        app.zone,
        &app.warn,
    );
    let charts: Vec<ChartCard> =
        pipelines.iter().map(|pipeline| ChartCard::new(pipeline, snapshot, app.zone)).collect();
    let marks = incidents.as_ref().map(|rows| IncidentMark::all(rows)).unwrap_or_default();
    Ok(Overview {
        shell: Shell::new(app, snapshot, "/", health.title.clone()).live(TOPIC),
        layout: charts.iter().map(|card| card.key.as_str()).collect::<Vec<_>>().join(" "),
        now: PipelineTable::new(pipelines),
        hosts,
        ended_hosts,
        ended_pipelines_note: shown.ended_pipelines_note(),
        truncation_note: [shown.current_count, snapshot.hosts.len()]
            .map(|all| list_limits::truncation_note(list_limits::MAX_ON_OVERVIEW, all)),
        incidents: incidents.map(|rows| IncidentLine::all(&rows, app.zone)),
        data: ChartCard::data(&charts, &marks)?,
        charts,
        health,
    })
}
