//! `peernet status`

use std::collections::BTreeMap;

use crate::exit::Failure;
use crate::output::print_to_stdout;
use chrono::{DateTime, SecondsFormat};
use peernet_analysis::table::text;
use peernet_analysis::trust::MissingCount;
use peernet_sample::printable_line;
use peernet_statistics::number::{self, DurationFormat};
use peernet_stream::PlacementKind;
use serde::Deserialize;

use crate::api::Api;

/// Arguments of `peernet status`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    api: Api,
}

#[derive(Debug, Deserialize)]
struct Pipelines {
    pipelines: Vec<Pipeline>,
}

#[derive(Debug, Deserialize)]
struct Pipeline {
    host: String,
    name: String,
    state: String,
    reason: Option<String>,
    placement: Placement,
    windows: Vec<Window>,
}

#[derive(Debug, Deserialize)]
struct Placement {
    kind: String,
    peer: Option<String>,
    address: Option<String>,
    model: String,
}

#[derive(Debug, Deserialize)]
struct Window {
    seconds: u32,
    rate_hz: f64,
    #[serde(rename = "lost_fraction")]
    failed_fraction: Option<f64>,
    /// Share of the iterations that ended after their deadline or failed. Absent in answers of earlier
    /// releases.
    miss_rate: Option<f64>,
    values: Vec<Statistics>,
}

#[derive(Debug, Deserialize)]
struct Statistics {
    name: String,
    mean: f64,
    std: Option<f64>,
    p50: Option<f64>,
    p95: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct Hosts {
    hosts: Vec<Host>,
    /// Absent in answers of earlier releases.
    #[serde(default)]
    clock_faults: FaultyClocks,
}

/// Hosts whose clock has an artificial error at present, with the error in words.
type FaultyClocks = BTreeMap<String, String>;

#[derive(Debug, Deserialize)]
struct Host {
    name: String,
    connected: bool,
    last_seen: Option<String>,
    now: Option<HostState>,
    /// Number of events that will never be in the database. Absent in answers of earlier releases.
    missing_events: Option<u64>,
    /// `true` if some missing events could not be counted. Absent in answers of earlier releases.
    #[serde(default)]
    missing_events_incomplete: bool,
}

#[derive(Debug, Deserialize)]
struct HostState {
    cpu: Option<f64>,
    events: Events,
}

#[derive(Debug, Deserialize)]
struct Events {
    /// Number of events that wait on the host for the aggregator.
    waiting: u64,
}

/// Length of the window that the table shows: long enough to be steady, short enough to be current.
const WINDOW_S: u32 = 10;

/// Prints the table of the pipelines and the table of the hosts.
///
/// # Errors
/// When the aggregator does not answer (exit code 69).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Pipelines { pipelines } = arguments.api.get("/api/v1/pipelines")?;
    let Hosts { hosts, clock_faults: faulty_clocks } = arguments.api.get("/api/v1/hosts")?;
    if pipelines.is_empty() {
        print_to_stdout(
            "no pipeline yet: start an agent with a [[pipeline]], and set its [agent] aggregator to this aggregator's address",
        );
    } else {
        let header = [
            "pipeline",
            "placement",
            "state",
            "rate /s",
            "failed %",
            "missed %",
            "p50 ms",
            "p95 ms",
            "upload ms",
            "inference ms",
            "download ms",
        ];
        print_to_stdout(text(
            &header,
            &pipelines.iter().map(|pipeline| pipeline_row(pipeline, &faulty_clocks)).collect::<Vec<_>>(),
        ));
        print_to_stdout(format_args!(
            "the last {WINDOW_S} s; missed: later than their deadline or failed; p50 and p95 are quantiles of the total, the stages are means"
        ));
        // Printed below the table: a reason is a sentence and would widen its column.
        pipelines.iter().filter_map(describe_reason).for_each(print_to_stdout);
    }
    print_to_stdout("");
    let header = ["host", "state", "CPU %", "waiting", "lost"];
    let rows: Vec<_> = hosts.iter().map(|host| host_row(host, &faulty_clocks)).collect();
    print_to_stdout(text(&header, &rows));
    for (name, error) in &faulty_clocks {
        print_to_stdout(format_args!(
            "\nCLOCK FAULT INJECTION: {name}'s clock is made wrong on purpose ({error}). The measured delays of {name} should stay the same."
        ));
    }
    Ok(())
}

/// Returns the line with the reason for a pipeline's state, if there is one. Agents send the reason, so it may contain
/// any characters.
fn describe_reason(pipeline: &Pipeline) -> Option<String> {
    let Pipeline { host, name, state, reason, .. } = pipeline;
    Some(format!("{host}/{name} is {state}: {}", printable_line(reason.as_ref()?)))
}

fn pipeline_row(pipeline: &Pipeline, faulty_clocks: &FaultyClocks) -> Vec<String> {
    let window = pipeline.windows.iter().find(|window| window.seconds == WINDOW_S);
    let statistics_of = |name: &str| {
        window.and_then(|window| window.values.iter().find(|statistics| statistics.name == name))
    };
    let total = statistics_of("total");
    let duration_format = DurationFormat::for_total(
        total.map(|statistics| statistics.mean),
        total.and_then(|statistics| statistics.std),
    );
    let milliseconds =
        |seconds: Option<f64>| or_dash(seconds.map(|seconds| duration_format.duration(seconds)));
    let mean = |name: &str| milliseconds(statistics_of(name).map(|statistics| statistics.mean));
    let Placement { kind, peer, address, model } = &pipeline.placement;
    // A peer has no name before the first session; until then its address identifies it.
    let placement_text = match peer.as_ref().or(address.as_ref()) {
        Some(peer_name) => format!("{model} on {peer_name}"),
        None if kind == PlacementKind::None.name() => "sensor alone".to_owned(),
        None if kind == PlacementKind::Local.name() => format!("{model} on board"),
        None => model.clone(),
    };
    // A pipeline is marked if the clock of either end is faulty.
    let ends = [Some(&pipeline.host), peer.as_ref()];
    let is_faulty = ends.into_iter().flatten().any(|host| faulty_clocks.contains_key(host));
    vec![
        format!("{}/{}", pipeline.host, pipeline.name),
        placement_text,
        with_clock_fault_mark(&pipeline.state, is_faulty),
        or_dash(window.map(|window| number::rate(window.rate_hz))),
        or_dash(window.and_then(|window| window.failed_fraction).map(number::percent)),
        or_dash(window.and_then(|window| window.miss_rate).map(number::percent)),
        milliseconds(total.and_then(|statistics| statistics.p50)),
        milliseconds(total.and_then(|statistics| statistics.p95)),
        mean("upload"),
        mean("inference"),
        mean("download"),
    ]
}

fn host_row(host: &Host, faulty_clocks: &FaultyClocks) -> Vec<String> {
    let state = match (&host.connected, &host.last_seen) {
        (true, _) => "connected".to_owned(),
        (false, Some(seen)) => format!("last seen {}", to_the_second(seen)),
        (false, None) => "never seen".to_owned(),
    };
    let now = host.now.as_ref();
    let missing = host
        .missing_events
        .map(|known| MissingCount { known, is_incomplete: host.missing_events_incomplete }.number());
    vec![
        host.name.clone(),
        with_clock_fault_mark(&state, faulty_clocks.contains_key(&host.name)),
        or_dash(now.and_then(|now| now.cpu).map(number::whole_percent)),
        or_dash(now.map(|now| number::count(now.events.waiting))),
        or_dash(missing),
    ]
}

/// Removes the fractions of a second from a time. A text that is not a time stays unchanged.
fn to_the_second(moment: &str) -> String {
    let time = DateTime::parse_from_rfc3339(moment);
    time.map_or_else(|_| moment.to_owned(), |time| time.to_rfc3339_opts(SecondsFormat::Secs, true))
}

/// Marks the state of a host or a pipeline if a clock that it uses has an artificial error.
fn with_clock_fault_mark(state: &str, is_faulty: bool) -> String {
    if is_faulty { format!("{state}, clock fault") } else { state.to_owned() }
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| number::NONE.to_owned())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn last_seen_time_is_shown_to_the_second() {
        assert_eq!(to_the_second("2026-11-20T22:41:07.123456789Z"), "2026-11-20T22:41:07Z");
    }

    #[test]
    fn reason_cannot_control_terminal() {
        let pipeline: Pipeline = serde_json::from_value(json!({
            "host": "edge", "name": "p", "state": "waiting", "reason": "no\u{1b}[2J\nanswer", "windows": [],
            "placement": { "kind": "remote", "peer": null, "address": null, "model": "m" },
        }))
        .expect("a pipeline");
        assert_eq!(describe_reason(&pipeline).as_deref(), Some("edge/p is waiting: no [2J answer"));
        assert_eq!(describe_reason(&Pipeline { reason: None, ..pipeline }), None);
    }

    #[test]
    fn short_totals_and_large_counts_are_formatted_as_on_pages() {
        let pipeline: Pipeline = serde_json::from_value(json!({
            "host": "edge", "name": "p", "state": "running", "reason": null,
            "placement": { "kind": "local", "peer": null, "address": null, "model": "m" },
            "windows": [{ "seconds": 10, "rate_hz": 20.0, "lost_fraction": null, "values": [
                { "name": "total", "mean": 48.31e-6, "p50": 48.2e-6, "p95": null },
                { "name": "inference", "mean": 22.4e-6, "p50": null, "p95": null },
            ] }],
        }))
        .expect("a pipeline");
        let row = pipeline_row(&pipeline, &FaultyClocks::default());
        assert_eq!(row[6..], ["0.0482", "—", "—", "0.0224", "—"]);
        let host: Host = serde_json::from_value(json!({
            "name": "edge", "connected": true, "last_seen": null, "missing_events": 1_050,
            "now": { "cpu": 0.29, "events": { "waiting": 40_000 } },
        }))
        .expect("a host");
        assert_eq!(host_row(&host, &FaultyClocks::default())[2..], ["29", "40,000", "1,050"]);
        let lost = |missing_events: u64| {
            let host: Host = serde_json::from_value(json!({
                "name": "edge", "connected": true, "last_seen": null, "now": null,
                "missing_events": missing_events, "missing_events_incomplete": true,
            }))
            .expect("a host");
            host_row(&host, &FaultyClocks::default())[4].clone()
        };
        assert_eq!([lost(0), lost(849)], ["an unknown number", "at least 849"]);
    }

    #[test]
    fn rows_of_hosts_with_clock_faults_are_marked() {
        let host = |name: &str| json!({ "name": name, "connected": true, "last_seen": null, "now": null });
        let fault = "offset +1000 ms, drift -50 ppm, step +300 ms after 20 s";
        let answer = json!({
            "hosts": [host("edge"), host("cloud")], "clock_faults": { "edge": fault, "away": fault },
        });
        let Hosts { hosts, clock_faults: faulty_clocks } =
            serde_json::from_value(answer).expect("as the API answers");
        let states: Vec<_> = hosts.iter().map(|host| host_row(host, &faulty_clocks)[1].clone()).collect();
        assert_eq!(states, ["connected, clock fault", "connected"]);

        let state = |host: &str, peer: &str| {
            let pipeline = json!({
                "host": host, "name": "p", "state": "running", "reason": null, "windows": [],
                "placement": { "kind": "remote", "peer": peer, "address": null, "model": "echo" },
            });
            let pipeline: Pipeline = serde_json::from_value(pipeline).expect("as the API answers");
            pipeline_row(&pipeline, &faulty_clocks)[2].clone()
        };
        assert_eq!(state("edge", "cloud"), "running, clock fault");
        assert_eq!(state("other", "away"), "running, clock fault");
        assert_eq!(state("other", "cloud"), "running");
    }
}
