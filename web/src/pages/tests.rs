//! Tests that render every page with live updates, in every state that the page's data may have.

mod clocks;
mod compare;
mod events;
mod lengths;
mod over_time;

use peernet_clock::{Span, Verdict};
use peernet_logger::Name;
use peernet_stream::{PipelineState, PlacementKind};

use self::clocks::live_state_with_link;
use super::*;
use crate::tests::samples::{self, HOSTILE, figures, host, incident, pipeline, placement, refused, snapshot};
use crate::view::pipeline_table::{Cell, PipelineTable};

/// Index of the window of 60 s. The windows of a pipeline have 1, 10 and 60 s.
const MINUTE_WINDOW: usize = 2;

/// Checks the HTML of a page: the security policy, escaping, closed elements and valid numbers.
fn check(html: &str) {
    assert!(!html.contains(" style="), "inline styles are refused by the policy: {html}");
    assert!(!html.contains("<script>alert") && !html.contains("onmouseover=\""), "not escaped: {html}");
    for script in html.split("<script").skip(1) {
        assert!(script.starts_with(" src=") || script.starts_with(" type=\"application/json\""), "{script}");
    }
    // A browser repairs unclosed elements silently, so only a count finds them.
    for element in ["svg", "table", "tr", "td", "ul", "section", "div", "dl", "span", "a"] {
        let opened =
            html.matches(&format!("<{element} ")).count() + html.matches(&format!("<{element}>")).count();
        let closed = html.matches(&format!("</{element}>")).count();
        assert_eq!(opened, closed, "<{element}> is not closed as often as opened");
    }
    assert!(!html.contains("NaN") && !html.contains(">inf<") && !html.contains("-0.00"), "{html}");
}

/// Returns the HTML of the overview.
async fn overview_of(
    snapshot: &peernet_aggregator::LiveState,
    incidents: Vec<peernet_store::IncidentRow>,
) -> String {
    let (app, _folder) = samples::app().await;
    let page = overview::overview(&app, snapshot, Ok(incidents)).expect("assembles");
    let html = askama::Template::render(&page).expect("renders");
    check(&html);
    html
}

#[tokio::test]
async fn overview_shows_running_pipeline_without_warnings() {
    // 30 iterations per second, the usual latencies times 1, related clocks, and no missing second.
    let live_state =
        snapshot(vec![host("cam-1", "Orin")], vec![pipeline("line", 30.0, 1.0, Verdict::Ok, &[])]);
    let html = overview_of(&live_state, vec![incident("connected", "reconnected to rack-a")]).await;
    assert!(html.contains(">1 pipeline running</h1>"), "{html}");
    assert!(html.contains("cam-1 → rack-a · zmq-tcp"));
    assert!(html.contains(">upload </tspan>6.3"));
    assert!(html.contains(">12:01:07</time>"));
    let label =
        "Stages of line over the last 10 minutes. In the 10 seconds before the page was loaded: Median ";
    assert!(html.contains(label), "{html}");
    let entry = html.split("data-stage=\"encode\"").nth(1).expect("a key");
    assert!(entry.split("</button>").next().is_some_and(|entry| entry.ends_with("encode, ipc")), "{entry}");
}

#[tokio::test]
async fn pipeline_with_deadline_adds_column_of_miss_rates() {
    let live = || pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
    let with_pipelines = |pipelines| snapshot(vec![host("cam-1", "Orin")], pipelines);
    assert!(!overview_of(&with_pipelines(vec![live()]), Vec::new()).await.contains("missed"));
    let mut late = live();
    late.windows[MINUTE_WINDOW].miss_rate = Some(0.012);
    let html =
        overview_of(&with_pipelines(vec![late, pipeline("other", 30.0, 1.0, Verdict::Ok, &[])]), Vec::new())
            .await;
    assert!(html.contains("data-h=\"missed %\">1.2</td>"), "{html}");
    assert!(html.contains("title=\"no deadline\">—</span>"), "{html}");
}

/// Returns a host whose processors have been busy for ten seconds.
fn busy_host() -> peernet_aggregator::HostSnapshot {
    let mut busy = host("cam-1", "Orin");
    busy.metrics.cpu = Some(0.94);
    busy.history = [10, 5, 0]
        .map(|ago| {
            let at = samples::NOW - Span::from_seconds(ago);
            std::sync::Arc::new(peernet_aggregator::MetricsPoint { at, metrics: busy.metrics.clone() })
        })
        .to_vec();
    busy
}

#[tokio::test]
async fn spread_latencies_and_busy_processors_cause_notes() {
    let mut live = pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
    let values = live.windows[MINUTE_WINDOW].values.iter_mut();
    for (_, statistics) in values.filter(|(name, _)| name.as_str() == "total") {
        (statistics.p50, statistics.p99) = (0.018, Some(0.311));
    }
    let html = overview_of(&snapshot(vec![busy_host()], vec![live]), Vec::new()).await;
    assert!(html.contains("1 pipeline running, 2 to look at"), "{html}");
    assert!(html.contains("has a p99 of 311\u{202f}ms in the last minute"), "{html}");
    assert!(
        html.contains(">cam-1:</a> the processors have been busy for 10\u{202f}s, never below 94\u{202f}%"),
        "{html}"
    );
}

#[tokio::test]
async fn overview_shows_charts_of_thirty_pipelines() {
    let pipelines = (0..30).map(|index| {
        pipeline(&format!("line-{index:02}"), 5.0, 1.0 + f64::from(index), Verdict::Limited, &[])
    });
    let html = overview_of(&snapshot(vec![host("cam-1", "Orin")], pipelines.collect()), Vec::new()).await;
    assert!(html.contains("30 pipelines running, 60 to look at"), "both directions of each are limited");
    assert!(html.contains("and 55 more"));
    assert_eq!(html.matches("class=\"chart live-chart").count(), 30);
}

#[tokio::test]
async fn long_lists_are_truncated_with_a_note() {
    let pipelines = (0..2_000).map(|index| {
        pipeline(&format!("line-{index:04}"), 5.0, 1.0 + f64::from(index), Verdict::Limited, &[])
    });
    let hosts = (0..2_000).map(|index| host(&format!("cam-{index:04}"), "Orin"));
    let live_state = snapshot(hosts.collect(), pipelines.collect());
    let html = overview_of(&live_state, Vec::new()).await;
    assert_eq!(html.matches("class=\"chart live-chart").count(), 100);
    assert_eq!(html.matches("the first 100 of 2,000").count(), 2);
    assert!(html.contains(">2,000 pipelines running, 4,000 to look at"), "{html}");
    assert!(html.contains("and 3,995 more"), "{html}");

    let (app, _folder) = samples::app().await;
    let updates = [
        (pipelines::update(&app, &live_state), ">2,000 pipelines, 2,000 running<"),
        (hosts::update(&app, &live_state), ">2,000 hosts, all connected<"),
    ];
    for (update, title) in updates {
        let parts = update.expect("renders").parts;
        assert!(parts.iter().any(|(_, html)| html.contains(title)), "{title}: {parts:?}");
        assert!(parts.iter().any(|(_, html)| html.contains("the first 500 of 2,000")), "{parts:?}");
        let tables = parts.iter().map(|(_, html)| html.matches("<tr><th scope=\"row\"").count());
        let tables: Vec<usize> = tables.filter(|rows| *rows > 0).collect();
        assert!(!tables.is_empty() && tables.iter().all(|rows| *rows == 500), "{tables:?}");
    }
}

#[tokio::test]
async fn refused_hosts_are_listed_on_hosts_page() {
    let (app, _folder) = samples::app().await;
    let mut live_state = snapshot(Vec::new(), Vec::new());
    live_state.refused.push(refused("its name is taken"));
    let update = hosts::update(&app, &live_state).expect("renders");
    let (_, html) = &update.parts[0];
    check(html);
    assert!(html.contains("cam-9 at ") && html.contains("its name is taken"), "{html}");
}

#[tokio::test]
async fn pages_wait_for_known_hosts_after_start() {
    let (app, _folder) = samples::app().await;
    let mut live_state = snapshot(Vec::new(), Vec::new());
    live_state.absent = 2;
    let html = askama::Template::render(&overview::empty_overview(&app, &live_state)).expect("renders");
    check(&html);
    assert!(
        html.contains("<h1>Waiting for agents to report</h1>") && html.contains("2 hosts are known"),
        "{html}"
    );
    assert!(!html.contains("make demo"), "{html}");
    for update in [hosts::update(&app, &live_state), pipelines::update(&app, &live_state)] {
        let (_, html) = &update.expect("renders").parts[0];
        check(html);
        assert!(html.contains(">Waiting for agents to report</h1>"), "{html}");
    }
}

#[tokio::test]
async fn missing_quantile_has_a_reason() {
    let html =
        overview_of(&snapshot(Vec::new(), vec![pipeline("slow", 0.5, 1.0, Verdict::Ok, &[])]), Vec::new())
            .await;
    assert!(html.contains("needs 300 iterations; the last minute has 30"), "{html}");
    let html =
        overview_of(&snapshot(Vec::new(), vec![pipeline("still", 0.0, 1.0, Verdict::Ok, &[])]), Vec::new())
            .await;
    assert!(html.contains("no successful iteration in this time"), "{html}");
}

#[tokio::test]
async fn bars_quantiles_and_whiskers_are_of_one_window() {
    let mut live = pipeline("line", 5.0, 1.0, Verdict::Ok, &[]);
    // The pipeline was slower in the last seconds than over the minute. A bar of the last seconds would end beyond the
    // quantiles of the minute.
    let window = |seconds, scale| samples::window(seconds, 30.0, scale, Verdict::Ok);
    live.windows = [window(1, 4.0), window(10, 4.0), window(60, 1.0)];
    let row = PipelineTable::new(&[&live]).rows.remove(0);
    let number = |cell: &Cell| cell.text.parse::<f64>().expect("a figure");
    assert!(number(&row.p50) <= number(&row.p95) && number(&row.p95) <= number(&row.p99), "{row:?}");
    let bar: f64 = row.total.parse().expect("a figure");
    assert!((bar - number(&row.p50)).abs() < 0.1, "`samples::window` has equal means and medians: {row:?}");
    let html = overview_of(&snapshot(Vec::new(), vec![live]), Vec::new()).await;
    assert!(html.contains("all figures: last 60&#x202f;s"), "{html}");
}

#[tokio::test]
async fn gap_is_null_in_chart_data() {
    let (app, _folder) = samples::app().await;
    let gap: Vec<i64> = (20..50).collect();
    let live_state = snapshot(Vec::new(), vec![pipeline("line", 30.0, 1.0, Verdict::Ok, &gap)]);
    let page = overview::overview(&app, &live_state, Ok(Vec::new())).expect("assembles");
    let html = askama::Template::render(&page).expect("renders");
    let data =
        html.split("id=\"data\">").nth(1).and_then(|rest| rest.split("</script>").next()).expect("a block");
    let data: serde_json::Value = serde_json::from_str(data).expect("JSON");
    let seconds = data["charts"][0]["n"].as_array().expect("seconds");
    assert_eq!((seconds.len(), seconds.iter().filter(|n| n.is_null()).count()), (121, 30));
}

#[tokio::test]
async fn unrelated_clocks_show_reason_and_exact_sum() {
    let html = overview_of(
        &snapshot(Vec::new(), vec![pipeline("line", 30.0, 1.0, Verdict::Unsynchronised, &[])]),
        Vec::new(),
    )
    .await;
    assert!(html.contains("chip bad"), "{html}");
    assert!(html.contains("their sum is exact"), "{html}");
    assert!(html.contains(">up + down </tspan>6.9"), "{html}");
}

#[tokio::test]
async fn huge_number_is_shown_with_all_digits() {
    let mut one = pipeline("line", 30_000.0, 5e6, Verdict::Ok, &[]);
    one.windows[MINUTE_WINDOW].values.push((Name::from("gripper"), figures(1e300, 5)));
    let html = overview_of(&snapshot(vec![host("cam-1", "Orin")], vec![one]), Vec::new()).await;
    // The usual total of 16.04 ms, times 5e6.
    assert!(html.contains("80,200,000.0"), "{html}");
}

#[tokio::test]
async fn hostile_texts_are_escaped_everywhere() {
    let mut remote = pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
    remote.placement.network = Some(HOSTILE.into());
    remote.placement.peer = None;
    remote.placement.address = Some(HOSTILE.into());
    remote.load = HOSTILE.into();
    remote.windows[1].values.insert(0, (Name::from(HOSTILE), figures(0.1, 300)));
    let mut failed = pipeline("failed", 30.0, 1.0, Verdict::Ok, &[]);
    failed.state = PipelineState::Failed(HOSTILE.into());
    let mut live_state = snapshot(vec![host("cam-1", HOSTILE)], vec![remote, failed]);
    live_state.refused.push(refused(HOSTILE));
    let html = overview_of(&live_state, vec![incident(HOSTILE, HOSTILE)]).await;
    assert!(html.contains("&#60;b&#62;"), "{html}");

    let (app, _folder) = samples::app().await;
    let mut hostile = samples::link(Some(0.00065), &[]);
    hostile.live.networks = vec![HOSTILE.into()];
    hostile.live.probing = peernet_stream::Probing::Off(HOSTILE.into());
    hostile.live.edge =
        hostile.live.edge.map(|clock| peernet_stream::HostClock { text: HOSTILE.into(), ..clock });
    live_state.links.push(std::sync::Arc::new(hostile));
    for update in [
        pipelines::update(&app, &live_state),
        hosts::update(&app, &live_state),
        links::update(&app, &live_state),
        link::update(&app, &live_state, "cam-1~rack-a/10min/removed").await,
        host::update(&app, &live_state, "cam-1"),
        pipeline::update(&app, &live_state, "cam-1/line/10"),
        pipeline::update(&app, &live_state, "cam-1/failed/60"),
    ] {
        update.expect("renders").parts.iter().for_each(|(_, html)| check(html));
    }
}

#[tokio::test]
async fn most_severe_problems_are_listed_first() {
    let mut away_host = host("cam-1", "Orin");
    away_host.connected = false;
    away_host.accounting.dropped = 1_050;
    away_host.behind = Some(Span::from_seconds(35));
    let mut waiting = pipeline("waiting", 0.0, 1.0, Verdict::Ok, &[]);
    waiting.state = PipelineState::Waiting("rack-a does not answer".into());
    let mut failed = pipeline("failed", 0.0, 1.0, Verdict::Ok, &[]);
    failed.state = PipelineState::Failed("no pictures in /data".into());
    let html = overview_of(&snapshot(vec![away_host], vec![waiting, failed]), Vec::new()).await;
    assert!(html.contains("No pipeline is running, 5 to look at"), "{html}");
    let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}"));
    assert!(at("stopped: no pictures in /data") < at("has not reported since 12:01:07"));
    assert!(at(">cam-1:</a> 1,050 events dropped") < at("waits: rack-a does not answer"));
    assert!(html.contains(">cam-1:</a> storing is 35\u{202f}s behind measuring"), "{html}");
    assert!(
        html.contains("dot warn") && !html.contains("dot bad"),
        "the dot has the tone of the notes: {html}"
    );
}

#[tokio::test]
async fn gap_of_unknown_size_is_noted_on_overview() {
    let mut host = host("cam-1", "Orin");
    (host.stored.gaps, host.stored.unknown_gaps) = (1, 1);
    let html = overview_of(&snapshot(vec![host], Vec::new()), Vec::new()).await;
    assert!(html.contains("an unknown number of events missing; "), "{html}");
}

#[tokio::test]
async fn host_that_said_goodbye_causes_no_warning() {
    let mut left = host("cam-1", "Orin");
    (left.connected, left.has_left) = (false, true);
    let mut ended = pipeline("line", 0.0, 1.0, Verdict::Ok, &[]);
    ended.state = PipelineState::Finished;
    let live_state = snapshot(vec![left], vec![ended]);
    let html = overview_of(&live_state, Vec::new()).await;
    assert!(!html.contains("to look at") && !html.contains("has not reported"), "{html}");
    let (app, _folder) = samples::app().await;
    let hosts: String =
        hosts::update(&app, &live_state).expect("renders").parts.into_iter().map(|(_, html)| html).collect();
    assert!(hosts.contains("dot quiet") && !hosts.contains("dot bad"), "{hosts}");
    for page in [&html, &hosts] {
        let ended_hosts =
            page.split_once("<summary>1 host has ended</summary>").expect("a closed disclosure").1;
        assert!(ended_hosts.contains("cam-1") && ended_hosts.contains("ended</span>"), "{page}");
        assert!(!page.contains("last seen"), "{page}");
    }
    let one = host::update(&app, &live_state, "cam-1").expect("renders");
    let one: String = one.parts.into_iter().map(|(_, html)| html).collect();
    assert!(one.contains("cam-1 disconnected at 12:01:07"), "{one}");
}

#[tokio::test]
async fn pipelines_of_ended_hosts_are_not_on_overview() {
    let mut left = host("cam-1", "Orin");
    (left.connected, left.has_left) = (false, true);
    let ended = |number: usize| {
        let mut ended = pipeline(&format!("ended-{number}"), 0.0, 1.0, Verdict::Ok, &[]);
        ended.state = PipelineState::Finished;
        ended
    };
    let html = overview_of(&snapshot(vec![left.clone()], (0..5).map(ended).collect()), Vec::new()).await;
    assert!(html.contains("ended-2") && !html.contains("ended-3"), "one row of charts: {html}");
    assert!(html.contains("2 pipelines of hosts that have ended are listed under"), "{html}");
    let mut running = pipeline("running", 30.0, 1.0, Verdict::Ok, &[]);
    // This host has not ended.
    running.host = peernet_logger::HostId::from_bytes([8; 16]);
    let html = overview_of(&snapshot(vec![left], vec![ended(0), running]), Vec::new()).await;
    assert!(html.contains("running") && !html.contains("ended-0"), "{html}");
    assert!(html.contains("1 pipeline of hosts that have ended is listed under"), "{html}");
}

#[tokio::test]
async fn unreadable_incidents_fail_only_their_panel() {
    let (app, _folder) = samples::app().await;
    let live_state = snapshot(Vec::new(), vec![pipeline("line", 30.0, 1.0, Verdict::Ok, &[])]);
    let page = overview::overview(&app, &live_state, Err("abc123".into())).expect("assembles");
    let html = askama::Template::render(&page).expect("renders");
    check(&html);
    assert!(html.contains("The incidents could not be read") && html.contains("abc123"), "{html}");
}

#[tokio::test]
async fn local_pipeline_has_no_clock_bound() {
    let mut local = pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
    local.placement = placement(PlacementKind::Local);
    let html = overview_of(&snapshot(vec![host("cam-1", "Orin")], vec![local]), Vec::new()).await;
    assert!(html.contains("one host: nothing crosses between clocks"), "{html}");
    assert!(html.contains("one host: nothing is sent"), "{html}");
}

#[tokio::test]
async fn pipeline_with_sensor_alone_shows_no_model() {
    let mut alone = pipeline("study", 30.0, 1.0, Verdict::Ok, &[]);
    alone.placement = peernet_stream::Placement::sensor_alone();
    let html = overview_of(&snapshot(vec![host("cam-1", "Orin")], vec![alone]), Vec::new()).await;
    assert!(html.contains("sensor alone") && !html.contains("none on board"), "{html}");
    assert!(html.contains("one host: nothing is sent"), "{html}");
}

#[tokio::test]
async fn accuracy_is_shown_for_labelled_samples() {
    let (app, _folder) = samples::app().await;
    let mut live_state =
        snapshot(vec![host("cam-1", "Orin")], vec![pipeline("line", 30.0, 1.0, Verdict::Ok, &[])]);
    let html = |live_state: &peernet_aggregator::LiveState| {
        let update = pipeline::update(&app, live_state, "cam-1/line/10").expect("renders");
        update.parts.into_iter().map(|(_, html)| html).collect::<String>()
    };
    assert!(!html(&live_state).contains("accuracy"), "there is no accuracy without labels");
    for window in &mut std::sync::Arc::make_mut(&mut live_state.pipelines[0]).windows {
        window.values.push((Name::from("top-1"), figures(0.875, 320)));
    }
    let html = html(&live_state);
    check(&html);
    assert!(html.contains("how often the model was right") && html.contains("87.5"), "{html}");
}

#[tokio::test]
async fn clock_fault_is_shown_on_every_page_it_concerns() {
    let since = samples::NOW;
    let clock_fault = peernet_clock::ClockFaults {
        offset: Span::from_seconds(1),
        drift_ppm: 50.0,
        steps: Vec::new(),
        since,
    };
    let mut live_state = live_state_with_link(Some(0.00065), Verdict::Ok);
    std::sync::Arc::make_mut(&mut live_state.hosts[0]).clock.faults = Some(clock_fault);
    let html = overview_of(&live_state, Vec::new()).await;
    assert!(
        html.contains(
            "Clock fault injection: cam-1&#39;s clock is made wrong on purpose (offset +1000 ms, drift +50 ppm)."
        ),
        "{html}"
    );
    let (app, _folder) = samples::app().await;
    for connected in [true, false] {
        std::sync::Arc::make_mut(&mut live_state.hosts[0]).connected = connected;
        for update in [
            pipeline::update(&app, &live_state, "cam-1/line/10"),
            host::update(&app, &live_state, "cam-1"),
            hosts::update(&app, &live_state),
            links::update(&app, &live_state),
            link::update(&app, &live_state, "cam-1~rack-a/10min/removed").await,
        ] {
            let html: String = update.expect("renders").parts.into_iter().map(|(_, html)| html).collect();
            assert_eq!(html.contains("#i-clock-fault"), connected, "{html}");
            assert!(connected || !html.contains("+1000 ms"), "{html}");
        }
    }
    let html = overview_of(&live_state, Vec::new()).await;
    assert!(!html.contains("made wrong on purpose"), "{html}");
}

#[tokio::test]
async fn update_of_live_page_has_only_the_live_parts() {
    let (app, _folder) = samples::app().await;
    let live_state =
        snapshot(vec![host("cam-1", "Orin")], vec![pipeline("line", 30.0, 1.0, Verdict::Ok, &[])]);
    let update = overview::update(&app, &live_state).await.expect("renders");
    let parts: Vec<&str> = update.parts.iter().map(|(id, _)| *id).collect();
    assert_eq!(parts, ["health", "now", "nowtable", "hosts", "incidents"]);
    assert_eq!(update.layout, "cam-1/line");
    for (id, html) in &update.parts {
        assert!(!html.trim().is_empty(), "{id} is empty");
        assert!(!html.contains("<html"), "{id} is a whole page");
    }
    for update in [
        pipelines::update(&app, &live_state),
        hosts::update(&app, &live_state),
        host::update(&app, &live_state, "cam-1"),
        pipeline::update(&app, &live_state, "cam-1/line/10"),
    ] {
        assert!(update.expect("renders").parts.iter().all(|(_, html)| !html.trim().is_empty()));
    }
    assert!(pipeline::update(&app, &live_state, "cam-1/other/10").is_err());
    assert!(pipeline::update(&app, &live_state, "cam-1/line/7").is_err());
}
