//! Page of one pipeline: its latency by stage, and its incidents.

use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::routing::get;
use peernet_aggregator::{LiveState, PipelineSnapshot, Window};
use peernet_analysis::accuracy::{ACCURACIES, ACCURACY_TITLES};
use peernet_clock::Direction;
use peernet_logger::{Slug, stage};
use peernet_statistics::number::{
    NONE, SPACE, count, duration, long_duration, percent, rate, share, total_ms,
};
use peernet_store::{QuantityStatistics, RunFilter, RunSummary};
use peernet_stream::{PipelineState, PlacementKind};
use serde::Deserialize;

use super::registration::{LiveTopic, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page, path};
use crate::error::WebError;
use crate::parameters::Parameters;
use crate::picture::Picture;
use crate::state::{App, AppState};
use crate::view::chart::{ChartCard, IncidentMark};
use crate::view::clock_fault::FaultyClocks;
use crate::view::clocks::ClockCell;
use crate::view::data::JsonBlock;
use crate::view::notes::Note;
use crate::view::pipeline_table::{state_chip, state_reason};
use crate::view::runs::RunLine;
use crate::view::speed;
use crate::view::stack::Stack;
use crate::view::stages::{StageRow, TOO_FEW};
use crate::view::{accuracy, chip::Chip, link, place};

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/pipelines/{host}/{pipeline}", get(show)),
    entry: None,
    topic: Some(LiveTopic {
        pattern: "pipeline/HOST/PIPELINE/SECONDS",
        update: |app, snapshot, rest| Box::pin(ready(update(app, snapshot, rest))),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "pipeline";
/// Maximum number of runs listed on the page.
const MAX_RUNS: u32 = 20;

/// Query parameters.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// Length of the window of the statistics, seconds: 1, 10 or 60.
    window: Option<u32>,
}

#[derive(Template)]
#[template(path = "pages/pipeline.html", blocks = ["title", "figures", "stages"])]
struct PipelinePage {
    shell: Shell,
    layout: String,
    host: String,
    title: String,
    chip: Option<Chip>,
    clock_fault: Option<Chip>,
    /// Address of the page of the link that the pipeline uses.
    link: Option<String>,
    notes: Vec<Note>,
    facts: Vec<String>,
    /// Number of the current run.
    run: Option<i64>,
    /// Length of the selected window, seconds.
    seconds: u32,
    /// Length of each window, seconds, and its name.
    windows: Vec<(u32, &'static str)>,
    stats: Vec<Stat>,
    clock: ClockCell,
    bar: Picture,
    stages: Vec<StageRow>,
    name: String,
    /// The chart of the pipeline. This is a list of one chart, because the page shares the template of charts with the
    /// overview.
    charts: Vec<ChartCard>,
    runs: Vec<RunLine>,
    data: JsonBlock,
}

/// A number with its name and unit.
struct Stat {
    name: &'static str,
    number: String,
    unit: &'static str,
    /// Explanation of the number, or the reason why the number is missing; may be empty.
    title: String,
}

/// `GET /pipelines/{host}/{pipeline}`.
async fn show(
    State(app): State<App>,
    names: Result<Path<(String, String)>, PathRejection>,
    Parameters(query): Parameters<Query>,
) -> Page {
    let (host, name) = path(names)?;
    let snapshot = app.live_state();
    let pipeline = find(&snapshot, &host, &name)?;
    let runs = runs(&app, pipeline).await?;
    let incidents = app.shown_incidents().await?;
    let marks = IncidentMark::all(&incidents);
    page(&pipeline_page(&app, &snapshot, pipeline, query.window.unwrap_or(10), &runs, &marks)?)
}

/// Renders the live parts of the page.
pub(super) fn update(app: &AppState, snapshot: &LiveState, rest: &str) -> Result<Update, WebError> {
    let mut parts = rest.splitn(3, '/');
    let (Some(host), Some(name), Some(seconds)) =
        (parts.next(), parts.next(), parts.next().and_then(|seconds| seconds.parse().ok()))
    else {
        return Err(WebError::BadRequest(
            "query parameter topics: the topic of a pipeline has the form pipeline/HOST/PIPELINE/SECONDS"
                .to_owned(),
        ));
    };
    let pipeline = find(snapshot, host, name)?;
    // The list of runs and the marks in the chart are not live parts, so an update needs no runs and no marks.
    let page = pipeline_page(app, snapshot, pipeline, seconds, &[], &[])?;
    let parts = vec![
        ("title", page.as_title().render()?),
        ("figures", page.as_figures().render()?),
        ("stages", page.as_stages().render()?),
    ];
    let obstacles = page.charts.iter().map(ChartCard::obstacles).collect();
    Ok(Update { layout: page.layout, obstacles, ..Update::new(page.shell.title, parts) })
}

fn find<'a>(snapshot: &'a LiveState, host: &str, name: &str) -> Result<&'a PipelineSnapshot, WebError> {
    snapshot.pipeline(host, name).ok_or_else(|| {
        WebError::NotFound(format!(
            "host {host} has not reported a pipeline {name}; the stored runs of such a pipeline are listed under /runs"
        ))
    })
}

async fn runs(app: &AppState, pipeline: &PipelineSnapshot) -> Result<Vec<RunSummary>, WebError> {
    let filter = RunFilter {
        pipeline: Some(pipeline.pipeline.clone()),
        host: Some(pipeline.host),
        limit: MAX_RUNS,
        ..RunFilter::default()
    };
    Ok(AppState::empty_if_store_is_closed(app.store().runs(&filter).await)?)
}

/// Returns the title of the page: latency and longest stage, or the reason why there is no
/// latency.
fn title(pipeline: &PipelineSnapshot, stack: &Stack) -> String {
    let name = &pipeline.pipeline;
    if let Some(reason) = state_reason(&pipeline.state) {
        return format!("{name} {reason}");
    }
    match (&pipeline.state, &stack.total) {
        (PipelineState::Away, _) => format!("{name}: its host is not connected"),
        (_, None) => format!("{name}: no iteration in this time"),
        (_, Some(total)) => {
            let stages = stack.split.longest_stages();
            let longest = stages.first().map_or_else(String::new, |(name, seconds)| {
                let stage_share = stack.split.share_of_mean_total(*seconds);
                let how = if stage_share > 0.5 { "most of it" } else { "longest" };
                format!(", {how} {name} ({}{SPACE}%)", share(stage_share))
            });
            // The title states the mean and not the median: the parts are means, and only means add up.
            format!("{name}: {} on average{longest}", duration(total.mean))
        }
    }
}

fn stats(kind: PlacementKind, window: &Window) -> Vec<Stat> {
    let total = window.value(&stage::TOTAL);
    let time = |name, number_of: fn(&QuantityStatistics) -> Option<f64>| {
        let value = total.and_then(number_of).map(total_ms);
        let (number, unit) = value.map_or((NONE.to_owned(), ""), |number| (number, "ms"));
        Stat { name, number, unit, title: if unit.is_empty() { TOO_FEW.to_owned() } else { String::new() } }
    };
    let speed = |name, direction| {
        let cell = speed::cell(kind, window, direction);
        Stat {
            name,
            unit: if cell.text == NONE { "" } else { "MB/s" },
            number: cell.text,
            title: cell
                .title
                .unwrap_or_else(|| "speed while sending: bytes over their transfer time".to_owned()),
        }
    };
    let traffic = speed::traffic(kind, window);
    let failed = window.failed_fraction.map_or_else(|| NONE.to_owned(), percent);
    let accuracies = ACCURACIES.into_iter().zip(ACCURACY_TITLES).filter_map(|(name, label)| {
        let (number, _) = accuracy::texts(window.value(name)?)?;
        let title = "accuracy: how often the model was right, where samples have labels".to_owned();
        Some(Stat { name: label, number, unit: "%", title })
    });
    let stats = vec![
        time("Median", |total| Some(total.p50)),
        time("p95", |total| total.p95),
        time("p99", |total| total.p99),
        time("Max", |total| Some(total.max)),
        Stat { name: "Rate", number: rate(window.rate_hz), unit: "/s", title: String::new() },
        Stat { name: "Iterations", number: count(window.counts.total()), unit: "", title: String::new() },
        Stat {
            name: "Failed",
            unit: if failed == NONE { "" } else { "%" },
            number: failed,
            title: String::new(),
        },
        speed("Speed up", Direction::Up),
        speed("Speed down", Direction::Down),
        Stat {
            name: "Traffic",
            unit: if traffic.text == NONE { "" } else { "MB/s" },
            number: traffic.text,
            title: traffic.title.unwrap_or_default(),
        },
    ];
    let missed = window.miss_rate.map(|rate| Stat {
        name: "Missed deadline",
        number: percent(rate),
        unit: "%",
        title: "share of iterations that took longer than the deadline or failed".to_owned(),
    });
    stats.into_iter().chain(missed).chain(accuracies).collect()
}

fn pipeline_page(
    app: &AppState,
    snapshot: &LiveState,
    pipeline: &PipelineSnapshot,
    seconds: u32,
    runs: &[RunSummary],
    marks: &[IncidentMark],
) -> Result<PipelinePage, WebError> {
    let window = pipeline.window(seconds).ok_or_else(|| {
        WebError::BadRequest(format!("query parameter window: {seconds} is not one of 1, 10 and 60"))
    })?;
    let stack = Stack::of_window(window);
    let host = pipeline.host_name.to_string();
    let placement = &pipeline.placement;
    let mut facts = vec![place::route(&host, placement)];
    facts.extend(placement.network.clone());
    facts.extend([place::model(placement), pipeline.load.clone()]);
    facts.push(format!(
        "last update {} ago",
        long_duration((snapshot.at - pipeline.last_seen).seconds().max(0.0))
    ));
    let charts = vec![ChartCard::new(pipeline, snapshot, app.zone)];
    let link = link::href_of_placement(snapshot, &host, placement);
    let cloud = placement.peer.as_ref().map_or("", Slug::as_str);
    // The page needs no link to itself.
    let href = "";
    Ok(PipelinePage {
        shell: Shell::new(app, snapshot, "/pipelines", format!("{} on {host}", pipeline.pipeline))
            .live(format!("{TOPIC}/{host}/{}/{seconds}", pipeline.pipeline)),
        title: title(pipeline, &stack),
        chip: state_chip(&pipeline.state),
        clock_fault: FaultyClocks::of(snapshot).chip(&[&host, cloud]),
        notes: Note::delay_notes(pipeline.pipeline.as_str(), href, link.as_deref(), &window.bounds, |name| {
            window.value(name).copied()
        }),
        link,
        facts,
        run: pipeline.run_number,
        seconds,
        windows: vec![(1, "1\u{202f}s"), (10, "10\u{202f}s"), (60, "1\u{202f}min")],
        stats: stats(placement.kind, window),
        clock: ClockCell::of(placement.kind, &window.bounds),
        bar: stack.full_width_bar("stages big"),
        stages: StageRow::of_window(window),
        runs: runs.iter().map(|run| RunLine::new(run, snapshot, app.zone)).collect(),
        layout: format!("{host}/{}", pipeline.pipeline),
        name: pipeline.pipeline.to_string(),
        data: ChartCard::data(&charts, marks)?,
        charts,
        host,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;
    use peernet_clock::Verdict;

    #[test]
    fn miss_rate_is_shown_where_there_is_a_deadline() {
        let mut window = samples::window(10, 30.0, 1.0, Verdict::Ok);
        let miss_rate = |window: &Window| {
            let stats = stats(PlacementKind::Remote, window);
            stats.into_iter().find(|stat| stat.name == "Missed deadline").map(|stat| stat.number)
        };
        assert_eq!(miss_rate(&window), None);
        window.miss_rate = Some(0.012);
        assert_eq!(miss_rate(&window).as_deref(), Some("1.2"));
    }

    #[test]
    fn title_takes_share_and_duration_from_means() {
        let mut pipeline = samples::pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
        let total = &mut pipeline.windows[1].values;
        let total = &mut total.iter_mut().find(|(name, _)| *name == stage::TOTAL).expect("a total").1;
        (total.mean, total.p50) = (0.0125, 0.011);
        let stack = Stack::of_window(pipeline.window(10).expect("a window"));
        assert_eq!(
            title(&pipeline, &stack),
            format!("line: 12.5{SPACE}ms on average, most of it upload (50.4{SPACE}%)")
        );
    }

    #[test]
    fn title_and_bar_name_same_longest_stage() {
        let mut pipeline = samples::pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
        let values = &mut pipeline.windows[1].values;
        let total = values.iter_mut().find(|(name, _)| *name == stage::TOTAL).expect("a total");
        // Most of this total is unattributed time.
        total.1.mean = 0.1;
        let stack = Stack::of_window(pipeline.window(10).expect("a window"));
        let (title, bar) = (title(&pipeline, &stack), stack.description((None, None)));
        assert!(
            title.contains("longest upload (6.3") && bar.contains("Longest stages: upload 6.3"),
            "{title}; {bar}"
        );
    }
}
