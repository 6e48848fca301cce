//! Page of one link: the accuracy of one-way delays between its hosts, and the state of the network.

use askama::Template;
use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::routing::get;
use peernet_aggregator::LiveState;
use peernet_clock::Span;
use peernet_store::{IncidentFilter, IncidentRow};
use serde::Deserialize;

use super::registration::{LiveTopic, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page, path};
use crate::error::WebError;
use crate::parameters::Parameters;
use crate::state::{App, AppState};
use crate::view::chip::Chip;
use crate::view::clock_fault::FaultyClocks;
use crate::view::incidents::IncidentLine;
use crate::view::link::basis;
use crate::view::link::chart::{OffsetView, tracks};
use crate::view::link::connections::{self, DirectionRow, Route};
use crate::view::link::finding::{Meaning, meanings, title};
use crate::view::link::origin::Origin;
use crate::view::link::panels::{self, HostRow, Pairs};
use crate::view::link::stats::{self, Stat};
use crate::view::link::table::Row;
use crate::view::link::time_series::LinkTimeSeries;
use crate::view::link::tracks::Tracks;
use crate::view::link::traffic::TrafficRow;
use crate::view::link::{Subject, canonical, find, no_link};

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/links/{link}", get(show)),
    entry: None,
    topic: Some(LiveTopic {
        pattern: "link/EDGE~CLOUD/RANGE/OFFSET",
        update: |app, snapshot, rest| Box::pin(update(app, snapshot, rest)),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "link";
/// Maximum number of points of the chart.
const MAX_POINTS: u32 = 360;
/// Incidents of the link are searched for among this number of newest incidents.
const SEARCHED_INCIDENTS: u32 = 1_000;
/// Maximum number of incidents that are listed.
const MAX_INCIDENTS: usize = 8;

/// Query parameters.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// `10min`, `1h` or `24h`.
    range: Range,
    /// `removed` or `measured`.
    offset: OffsetView,
}

/// Time range of the chart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
enum Range {
    #[default]
    #[serde(rename = "10min")]
    TenMinutes,
    #[serde(rename = "1h")]
    Hour,
    #[serde(rename = "24h")]
    Day,
}

impl Range {
    const ALL: [Self; 3] = [Self::TenMinutes, Self::Hour, Self::Day];

    const fn query_value(self) -> &'static str {
        match self {
            Self::TenMinutes => "10min",
            Self::Hour => "1h",
            Self::Day => "24h",
        }
    }

    const fn seconds(self) -> i64 {
        match self {
            Self::TenMinutes => 600,
            Self::Hour => 3_600,
            Self::Day => 86_400,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::TenMinutes => "10\u{202f}min",
            Self::Hour => "1\u{202f}h",
            Self::Day => "24\u{202f}h",
        }
    }

    const fn heading(self) -> &'static str {
        match self {
            Self::TenMinutes => "The last 10 minutes",
            Self::Hour => "The last hour",
            Self::Day => "The last 24 hours",
        }
    }
}

#[derive(Template)]
#[template(
    path = "pages/link.html",
    blocks = ["title", "figures", "chart", "table", "verdicts", "origin", "assumptions", "probes", "pipelines", "connections", "clocks", "incidents"]
)]
pub(super) struct Link {
    shell: Shell,
    name: String,
    edge: String,
    route: String,
    title: String,
    facts: Vec<String>,
    /// Name of each pipeline that uses the link, and the address of its page.
    pipelines: Vec<(String, String)>,
    clock_fault: Option<Chip>,
    same_clock: bool,
    /// Heading of the chart.
    heading: &'static str,
    /// Address and name of each time range, and `true` for the selected one.
    ranges: Vec<(String, &'static str, bool)>,
    /// Address and name of each view of the offset, and `true` for the selected one.
    views: Vec<(String, &'static str, bool)>,
    stats: Vec<Stat>,
    chart: Tracks,
    rows: Vec<Row>,
    meanings: Vec<Meaning>,
    origin: Origin,
    /// Conditions under which the bounds hold; `None` if both hosts read one clock, or the
    /// conditions are not known.
    promise: Option<String>,
    assumptions: Pairs,
    probes: Pairs,
    reflector: Pairs,
    traffic: Vec<TrafficRow>,
    directions: Vec<DirectionRow>,
    connections: Vec<Route>,
    hosts: Vec<HostRow>,
    exchanges: Pairs,
    incidents: Vec<IncidentLine>,
}

/// `GET /links/{link}`.
async fn show(
    State(app): State<App>,
    link: Result<Path<String>, PathRejection>,
    Parameters(query): Parameters<Query>,
) -> Page {
    let link_name = canonical(path(link)?);
    let snapshot = app.live_state();
    let incidents = AppState::empty_if_store_is_closed(
        app.store().incidents(&IncidentFilter::newest(SEARCHED_INCIDENTS)).await,
    )?;
    if let Some(link) = find(&snapshot, &link_name) {
        let subject = Subject::live(link);
        // The figures above the chart are of the last ten minutes, whatever the range of the chart.
        let recent_series = LinkTimeSeries::live(&link.history, subject.end, Range::TenMinutes.seconds());
        let selected_series = match query.range {
            Range::TenMinutes => None,
            range => Some(read_time_series(&app, &subject, range).await?),
        };
        return page(&link_page(
            &app,
            &snapshot,
            &subject,
            &recent_series,
            selected_series.as_ref(),
            query,
            &incidents,
        ));
    }
    let rows = app.store().links().await?;
    let mut stored_links = rows.iter().map(Subject::past);
    let subject = stored_links.find(|link| link.name() == link_name).ok_or_else(|| no_link(&link_name))?;
    let time_series = read_time_series(&app, &subject, query.range).await?;
    let assumptions = app.store().link_assumptions(&subject.key).await?;
    let subject = subject.with_last_offset(&time_series).with_assumptions(assumptions);
    // A past link has no recent measurements, so the figures above the chart also cover the selected range.
    let selected_series = None;
    page(&link_page(&app, &snapshot, &subject, &time_series, selected_series, query, &incidents))
}

async fn read_time_series(
    app: &AppState,
    subject: &Subject<'_>,
    range: Range,
) -> Result<LinkTimeSeries, WebError> {
    let (from, to) = (subject.end - Span::from_seconds(range.seconds()), subject.end);
    let series = app.store().clock_series(&subject.key, from, to, MAX_POINTS).await?;
    Ok(LinkTimeSeries::stored(series, from, to))
}

/// Renders the live parts of the page.
pub(super) async fn update(app: &AppState, snapshot: &LiveState, rest: &str) -> Result<Update, WebError> {
    let mut parts = rest.splitn(3, '/');
    let (Some(link_name), Some(range), Some(view)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(WebError::BadRequest(
            "query parameter topics: the topic of a link has the form link/EDGE~CLOUD/RANGE/OFFSET"
                .to_owned(),
        ));
    };
    let range = Range::ALL.into_iter().find(|candidate| candidate.query_value() == range);
    let view = [OffsetView::DriftRemoved, OffsetView::Measured]
        .into_iter()
        .find(|candidate| candidate.word() == view);
    let (Some(range), Some(offset)) = (range, view) else {
        return Err(WebError::BadRequest(
            "query parameter topics: the range of a link is 10min, 1h or 24h, its offset removed or measured"
                .to_owned(),
        ));
    };
    let link = find(snapshot, link_name).ok_or_else(|| no_link(link_name))?;
    let incidents = app.cached_incidents().await?;
    let subject = Subject::live(link);
    let recent_series = LinkTimeSeries::live(&link.history, subject.end, Range::TenMinutes.seconds());
    // The chart of a longer range is not updated, so only the recent time series is needed.
    let selected_series = None;
    let query = Query { range, offset };
    let page = link_page(app, snapshot, &subject, &recent_series, selected_series, query, &incidents);
    let mut parts = vec![
        ("title", page.as_title().render()?),
        ("figures", page.as_figures().render()?),
        ("verdicts", page.as_verdicts().render()?),
        ("origin", page.as_origin().render()?),
        ("assumptions", page.as_assumptions().render()?),
        ("probes", page.as_probes().render()?),
        ("pipelines", page.as_pipelines().render()?),
        ("connections", page.as_connections().render()?),
        ("clocks", page.as_clocks().render()?),
    ];
    // Charts of longer ranges are read from the store, so the live stream does not update them.
    if range == Range::TenMinutes {
        parts.extend([
            ("chart", page.as_chart().render()?),
            ("table", page.as_table().render()?),
            ("incidents", page.as_incidents().render()?),
        ]);
    }
    Ok(Update::new(page.shell.title, parts))
}

/// Returns the incidents of both hosts within the time range, newest first. Their times are converted to the edge's clock.
fn incidents_of_link(
    subject: &Subject<'_>,
    time_series: &LinkTimeSeries,
    rows: &[IncidentRow],
) -> Vec<IncidentRow> {
    let names = [subject.edge.as_str(), subject.cloud.as_str()];
    let is_host_of_link = |name: &str| names.contains(&name);
    // Incidents of these kinds say nothing about the network between the two hosts.
    let concerns_network =
        |row: &&IncidentRow| !matches!(row.kind.as_str(), "model-loaded" | "model-unloaded" | "control");
    let of_link = rows.iter().filter(concerns_network);
    let of_link = of_link.filter(|row| {
        row.host_name.as_ref().is_some_and(|name| is_host_of_link(name.as_str()))
            && row.peer.as_deref().is_none_or(is_host_of_link)
    });
    let with_edge_times = of_link.map(|row| {
        let reporter = row.host_name.as_ref().map(peernet_logger::Slug::as_str);
        let is_from_cloud = reporter == Some(subject.cloud.as_str()) && subject.cloud != subject.edge;
        IncidentRow {
            at: if is_from_cloud { time_series.edge_time_at(row.at) } else { row.at },
            ..row.clone()
        }
    });
    let mut with_edge_times: Vec<_> =
        with_edge_times.filter(|row| row.at > time_series.from && row.at <= time_series.to).collect();
    with_edge_times.sort_by_key(|row| std::cmp::Reverse(row.at));
    with_edge_times
}

fn facts(subject: &Subject<'_>, snapshot: &LiveState) -> Vec<String> {
    let mut facts = vec![subject.key.network.to_string()];
    if let Some(link) = subject.live {
        facts.push(panels::probing(&link.live.probing));
        if !link.connected {
            let ago =
                peernet_statistics::number::long_duration((snapshot.at - link.last_seen).seconds().max(0.0));
            facts.push(format!("reported {ago} ago"));
        }
    }
    facts.extend(basis::trust_remarks(subject));
    facts.push(format!("times of {}'s clock", subject.edge));
    facts
}

/// Returns the page. The chart, its table and the incidents show `selected_series`; `None` if they
/// show `recent_series`, like the rest of the page.
pub(super) fn link_page(
    app: &AppState,
    snapshot: &LiveState,
    subject: &Subject<'_>,
    recent_series: &LinkTimeSeries,
    selected_series: Option<&LinkTimeSeries>,
    query: Query,
    incidents: &[IncidentRow],
) -> Link {
    let time_series = selected_series.unwrap_or(recent_series);
    let name = subject.name();
    let link_incidents = incidents_of_link(subject, time_series, incidents);
    let address =
        |range: Range, offset: OffsetView| format!("?range={}&offset={}", range.query_value(), offset.word());
    let shell = Shell::new(app, snapshot, "/links", subject.route());
    let topic = format!("{TOPIC}/{name}/{}/{}", query.range.query_value(), query.offset.word());
    let faulty_clocks = FaultyClocks::of(snapshot);
    Link {
        shell: if subject.live.is_some() { shell.live(topic) } else { shell },
        edge: subject.edge.clone(),
        route: subject.route(),
        title: title(subject, app.zone),
        facts: facts(subject, snapshot),
        pipelines: subject.pipelines(),
        clock_fault: faulty_clocks.chip(&[&subject.edge, &subject.cloud]),
        same_clock: subject.same_clock(),
        heading: query.range.heading(),
        ranges: Range::ALL
            .map(|range| (address(range, query.offset), range.name(), range == query.range))
            .to_vec(),
        views: [(OffsetView::DriftRemoved, "drift removed"), (OffsetView::Measured, "as measured")]
            .map(|(view, name)| (address(query.range, view), name, view == query.offset))
            .to_vec(),
        stats: stats::all(subject, recent_series),
        chart: tracks(subject, time_series, query.offset, &link_incidents, app.zone),
        rows: Row::all(time_series, app.zone),
        meanings: meanings(subject),
        origin: Origin::of(subject, recent_series),
        promise: subject.assumptions.as_ref().map(basis::promise),
        assumptions: basis::pairs(subject, recent_series),
        probes: panels::probes(subject, recent_series),
        reflector: panels::reflector(subject),
        traffic: TrafficRow::all(snapshot, subject),
        directions: connections::rows(subject),
        connections: connections::routes(subject),
        hosts: panels::hosts(subject, &faulty_clocks),
        exchanges: panels::exchanges(subject),
        incidents: IncidentLine::all(&link_incidents[..link_incidents.len().min(MAX_INCIDENTS)], app.zone),
        name,
    }
}
