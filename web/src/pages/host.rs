//! Page of one host: its hardware, its clock, and the counts of its events.

use std::future::ready;

use askama::Template;
use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::routing::get;
use peernet_aggregator::{HostSnapshot, LiveState};
use peernet_statistics::number::{NONE, SPACE, bytes, count, counted, fixed, gigabytes};
use peernet_store::HostRow;
use peernet_stream::{HostClock, HostDescription, PipelineState};

use super::registration::{LiveTopic, PageRegistration};
use super::shell::Shell;
use super::{Page, Update, page, path};
use crate::error::WebError;
use crate::state::{App, AppState};
use crate::view::clock_fault::FaultyClocks;
use crate::view::events::{self, Events};
use crate::view::hosts::{HostLine, clock_words, hardware_name};
use crate::view::link::Subject;
use crate::view::link::panels::{describe_synchronisation, reported_error_bounds};
use crate::view::list_limits;
use crate::view::pipeline_table::{PipelineRow, PipelineTable};
use crate::zone::ZonedTime;

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/hosts/{host}", get(show)),
    entry: None,
    topic: Some(LiveTopic {
        pattern: "host/HOST",
        update: |app, snapshot, rest| Box::pin(ready(update(app, snapshot, rest))),
    }),
};

/// Name of this page's topic of the live stream.
const TOPIC: &str = "host";

/// Pairs of a name and a text.
type Pairs = Vec<(&'static str, String)>;

#[derive(Template)]
#[template(path = "pages/host.html", blocks = ["title", "now", "accounting", "pipelines", "clock", "stored"])]
struct Host {
    shell: Shell,
    name: String,
    title: String,
    facts: Vec<String>,
    /// Route of each link of the host, and address of the link's page.
    links: Vec<(String, String)>,
    line: HostLine,
    agent: Pairs,
    hardware: Pairs,
    clock: Pairs,
    events: Events,
    stored: Pairs,
    pipelines: Vec<PipelineRow>,
}

/// A host that is stored but not in the live state.
#[derive(Template)]
#[template(path = "pages/host_past.html")]
struct PastHost {
    shell: Shell,
    name: String,
    title: String,
    first_seen: ZonedTime,
    agent: Pairs,
    hardware: Pairs,
    clock: Pairs,
    stored: Pairs,
}

/// `GET /hosts/{host}`.
async fn show(State(app): State<App>, name: Result<Path<String>, PathRejection>) -> Page {
    let name = path(name)?;
    let snapshot = app.live_state();
    if let Some(host) = find_live(&snapshot, &name) {
        return page(&host_page(&app, &snapshot, host));
    }
    let row = app.store().host(&name).await?;
    let row = row
        .ok_or_else(|| WebError::NotFound(format!("no host {name} has ever reported to this aggregator")))?;
    page(&past_page(&app, &snapshot, &row))
}

/// Renders the live parts of the page.
pub(super) fn update(app: &AppState, snapshot: &LiveState, name: &str) -> Result<Update, WebError> {
    let host = find_live(snapshot, name).ok_or_else(|| {
        WebError::NotFound(format!("no host {name} is in the live state of this aggregator"))
    })?;
    let page = host_page(app, snapshot, host);
    let parts = vec![
        ("title", page.as_title().render()?),
        ("now", page.as_now().render()?),
        ("accounting", page.as_accounting().render()?),
        ("pipelines", page.as_pipelines().render()?),
        ("clock", page.as_clock().render()?),
        ("stored", page.as_stored().render()?),
    ];
    Ok(Update::new(page.shell.title, parts))
}

fn find_live<'a>(snapshot: &'a LiveState, name: &str) -> Option<&'a HostSnapshot> {
    let matches =
        |host: &&HostSnapshot| host.description.name.as_str() == name || host.id.to_string() == name;
    snapshot.hosts.iter().map(|host| &**host).find(matches)
}

fn hardware(description: &HostDescription) -> Pairs {
    let hardware = &description.hardware;
    let or_dash = |text: &str| if text.is_empty() { NONE.to_owned() } else { text.to_owned() };
    vec![
        ("Processor", or_dash(&hardware.cpu)),
        ("Cores", count(hardware.cores.into())),
        ("Memory", format!("{}{SPACE}GB", gigabytes(hardware.memory_bytes))),
        ("Accelerators", or_dash(&hardware.gpus.join(", "))),
        ("System", or_dash(&hardware.system)),
        ("Architecture", or_dash(&hardware.architecture)),
    ]
}

fn agent(description: &HostDescription) -> Pairs {
    let models = description.models.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    vec![
        ("Version", description.version.clone()),
        ("Host id", description.id.to_string()),
        ("Serves", description.serves.clone().unwrap_or_else(|| format!("{NONE} no models for others"))),
        ("Models", if models.is_empty() { NONE.to_owned() } else { models }),
    ]
}

/// Returns the number of detected interruptions of the clock as text: steps, suspensions and excessive drifts.
fn interruption_count_text(clock: &HostClock) -> String {
    match clock.epoch {
        0 => "none since the agent started".to_owned(),
        1 => "1 since the agent started".to_owned(),
        many => format!("{} since the agent started", count(many.into())),
    }
}

/// Returns the routes of the links of a host, each with the address of its page.
fn links(snapshot: &LiveState, name: &str) -> Vec<(String, String)> {
    let links = snapshot.links.iter().map(|link| Subject::live(link));
    let links = links.filter(|link| link.edge == name || link.cloud == name);
    links.map(|link| (link.route(), link.href())).take(list_limits::MAX_IN_LIST).collect()
}

fn host_page(app: &AppState, snapshot: &LiveState, host: &HostSnapshot) -> Host {
    let description = &host.description;
    let name = description.name.to_string();
    let own_pipelines: Vec<_> = snapshot
        .pipelines
        .iter()
        .filter(|pipeline| pipeline.host == host.id)
        .map(|pipeline| &**pipeline)
        .collect();
    let running = || snapshot.pipelines.iter().filter(|pipeline| pipeline.state == PipelineState::Running);
    let own_running = running().filter(|pipeline| pipeline.host == host.id).count();
    let serving = running().filter(|pipeline| pipeline.placement.peer.as_ref() == Some(&description.name));
    let title = match (host.connected, own_running, serving.count()) {
        (false, ..) if host.has_left => {
            format!("{name} disconnected at {}", app.zone.moment(host.last_seen).time_of_day())
        }
        (false, ..) => {
            format!("{name} has not reported since {}", app.zone.moment(host.last_seen).time_of_day())
        }
        (true, 0, 0) => format!("{name} is connected and idle"),
        (true, own, 0) => format!("{name} runs {}", counted(own as u64, "pipeline")),
        (true, 0, others) => format!("{name} serves {} of other hosts", counted(others as u64, "pipeline")),
        (true, own, others) => format!("{name} runs {own} and serves {others}"),
    };
    let faulty_clocks = FaultyClocks::of(snapshot);
    let aggregator_clock = app.clock.identity();
    let (clock, relation) = clock_words(&description.clock, aggregator_clock, host.clock_ahead);
    let memory = host
        .metrics
        .agent_memory_bytes
        .map(|size| format!("the agent uses {} of memory", bytes(size as f64)));
    let models = host.metrics.models.filter(|models| models.loaded > 0).map(|models| {
        let number = counted(u64::from(models.loaded), "model");
        format!("{number} loaded, {}", bytes(models.memory_bytes as f64))
    });
    let cpu = host
        .metrics
        .agent_cpu
        .map(|share| format!("the agent uses {}{SPACE}% of a core", fixed(share * 100.0, 1)));
    Host {
        shell: Shell::new(app, snapshot, "/hosts", name.as_str()).live(format!("{TOPIC}/{name}")),
        title,
        facts: [Some(hardware_name(&description.hardware)), cpu, memory, models]
            .into_iter()
            .flatten()
            .filter(|fact| !fact.is_empty())
            .collect(),
        links: links(snapshot, &name),
        line: HostLine::new(host, &faulty_clocks, aggregator_clock, snapshot.at, app.zone, &app.warn),
        agent: agent(description),
        hardware: hardware(description),
        clock: vec![
            ("Wall clock", clock),
            ("Relation to the aggregator's clock", relation),
            ("Synchronised by", describe_synchronisation(&host.clock)),
            ("Reported error bound", reported_error_bounds(&host.clock)),
            ("Clock interruptions", interruption_count_text(&host.clock)),
            (
                "Clock fault",
                faulty_clocks.0.get(&name).cloned().unwrap_or_else(|| "none reported".to_owned()),
            ),
            ("Boot id", description.clock.boot.to_string()),
            ("Clock name", description.clock.clock.to_string()),
        ],
        events: Events::of(host),
        stored: events::stored_count_pairs(
            &host.stored,
            Some(&host.rejected_batches),
            host.newest_stored,
            app.zone,
        ),
        pipelines: PipelineTable::new(&own_pipelines).rows,
        name,
    }
}

fn past_page(app: &AppState, snapshot: &LiveState, row: &HostRow) -> PastHost {
    let name = row.name.to_string();
    let seen = app.zone.moment(row.last_seen);
    let description = &row.description;
    // Only the live state has the counts of rejected batches and the time of the newest stored event.
    let (rejected, newest_stored) = (None, None);
    PastHost {
        shell: Shell::new(app, snapshot, "/hosts", name.as_str()),
        title: format!("{name} was last seen on {}, {}", seen.date(), seen.time_of_day()),
        first_seen: app.zone.moment(row.first_seen),
        agent: agent(description),
        hardware: hardware(description),
        clock: vec![
            ("Boot id", description.clock.boot.to_string()),
            ("Clock name", description.clock.clock.to_string()),
        ],
        stored: events::stored_count_pairs(&row.stored, rejected, newest_stored, app.zone),
        name,
    }
}
