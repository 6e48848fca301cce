//! Tests of the answer for Prometheus, read line by line as the OpenMetrics specification defines it.

use std::collections::{BTreeMap, BTreeSet};

use peernet_clock::Span;

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

/// The lines of one metric, as read from an answer.
#[derive(Debug, Default, PartialEq)]
struct Family {
    kind: String,
    unit: String,
    help: String,
    /// Names of the labels.
    labels: BTreeSet<String>,
    /// Values by series: name and labels, as in the line.
    samples: BTreeMap<String, f64>,
}

/// Returns the names in a list of labels, `name="value",…`, in which values may contain escapes.
fn label_names(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut rest = text;
    while !rest.is_empty() {
        let (name, value) = rest.split_once("=\"").unwrap_or_else(|| panic!("no value in {rest:?}"));
        assert!(name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'), "label {name:?}");
        let mut escaped = false;
        let end = value.find(|character| match character {
            '"' if !escaped => true,
            _ => {
                escaped = character == '\\' && !escaped;
                false
            }
        });
        let end = end.unwrap_or_else(|| panic!("no end in {value:?}"));
        names.push(name.to_owned());
        rest = &value[end + 1..];
        rest = match rest.strip_prefix(',') {
            Some(next) => next,
            None if rest.is_empty() => rest,
            None => panic!("no comma in {rest:?}"),
        };
    }
    names
}

/// Parses an answer into metrics by name. Panics at the first invalid line.
fn parse_metrics(text: &str) -> BTreeMap<String, Family> {
    let body = text.strip_suffix("# EOF\n").expect("the answer ends with an end mark");
    let mut families: BTreeMap<String, Family> = BTreeMap::new();
    let mut current = String::new();
    for line in body.lines() {
        if let Some(about) = line.strip_prefix("# ") {
            let mut parts = about.splitn(3, ' ');
            let (what, name) = (parts.next().expect("a word"), parts.next().expect("a name"));
            let text = parts.next().unwrap_or_else(|| panic!("no text in {line:?}")).to_owned();
            if name != current {
                assert!(!families.contains_key(name), "{name} is described twice");
                current = name.to_owned();
            }
            let family = families.entry(current.clone()).or_default();
            match what {
                "HELP" => family.help = text,
                "TYPE" => family.kind = text,
                "UNIT" => family.unit = text,
                _ => panic!("{line:?}"),
            }
            continue;
        }
        let (series, value) = line.rsplit_once(' ').unwrap_or_else(|| panic!("no value in {line:?}"));
        let value: f64 = value.parse().unwrap_or_else(|_| panic!("no number in {line:?}"));
        let (name, inner) = match series.split_once('{') {
            Some((name, inner)) => (name, inner.strip_suffix('}').expect("closed")),
            None => (series, ""),
        };
        let family = families.get_mut(&current).expect("described before");
        let suffix = if family.kind == "counter" { "_total" } else { "" };
        assert_eq!(name, format!("{current}{suffix}"), "{line:?} is not below its description");
        assert!(family.kind == "counter" || family.kind == "gauge", "{line:?}");
        assert!(value.is_finite() && (value >= 0.0 || family.kind == "gauge"), "{line:?}");
        let names = label_names(inner);
        let label_set: BTreeSet<String> = names.iter().cloned().collect();
        assert_eq!(label_set.len(), names.len(), "a label occurs twice: {line:?}");
        assert!(
            family.samples.is_empty() || family.labels == label_set,
            "other labels than before: {line:?}"
        );
        family.labels = label_set;
        assert!(family.samples.insert(series.to_owned(), value).is_none(), "{series} occurs twice");
    }
    for (name, family) in &families {
        assert!(
            name.starts_with("peernet_") && name.ends_with(&format!("_{}", family.unit)),
            "{name}: {family:?}"
        );
        assert!(!family.unit.is_empty() && !name.ends_with("_total"), "{name}: {family:?}");
        assert!(family.help.ends_with('.') && !family.kind.is_empty(), "{name}: {family:?}");
    }
    families
}

#[tokio::test]
async fn metric_lines_are_valid_and_counters_grow() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![
        TestPipeline::local(),
        TestPipeline::full(),
        TestPipeline::unrelated(),
    ])
    .await;
    let answer = dashboard.get("/metrics").await;
    assert_eq!(answer.header("content-type"), "application/openmetrics-text; version=1.0.0; charset=utf-8");
    let first = parse_metrics(answer.text());

    let value = |families: &BTreeMap<String, Family>, series: &str| {
        let name = series.split('{').next().expect("a name").trim_end_matches("_total");
        let family = families.get(name).unwrap_or_else(|| panic!("no {name}"));
        *family.samples.get(series).unwrap_or_else(|| panic!("no {series} in {:?}", family.samples))
    };
    assert_eq!(value(&first, "peernet_aggregator_ready_bool"), 1.0);
    assert_eq!(value(&first, "peernet_aggregator_connected_hosts"), 4.0);
    assert_eq!(value(&first, "peernet_host_connected_bool{host=\"cam-2\"}"), 1.0);
    assert_eq!(value(&first, "peernet_host_loaded_models{host=\"cam-2\"}"), 1.0);
    assert_eq!(value(&first, "peernet_host_model_memory_bytes{host=\"cam-2\"}"), 96e6);
    let total = "peernet_pipeline_stage_seconds{host=\"cam-2\",pipeline=\"offload-full\",stage=\"total\",quantile=\"0.5\"}";
    assert!((0.015..0.03).contains(&value(&first, total)), "{}", value(&first, total));
    let ok =
        "peernet_pipeline_window_iterations{host=\"cam-1\",pipeline=\"local\",outcome=\"ok\",window=\"60s\"}";
    assert!(value(&first, ok) > 1_000.0, "{}", value(&first, ok));
    assert!(
        value(
            &first,
            "peernet_link_offset_half_width_seconds{edge=\"cam-2\",cloud=\"rack-a\",network=\"zmq-tcp\"}"
        ) > 0.0
    );
    let loss =
        value(&first, "peernet_link_probe_loss_ratio{edge=\"cam-2\",cloud=\"rack-a\",network=\"zmq-tcp\"}");
    assert!((0.0..=1.0).contains(&loss), "{loss}");
    let retransmitted = "peernet_link_retransmitted_datagrams_total{edge=\"cam-2\",cloud=\"rack-a\",network=\"zmq-tcp\",\
                 pipeline=\"offload-full\",direction=\"upload\"}";
    assert_eq!(value(&first, retransmitted), 17.0);
    assert!(first["peernet_link_lost_datagrams"].samples.is_empty(), "an unknown count has a sample");
    // The cloud received what the edge sent, and cannot know how much was retransmitted.
    let upload = "transferred_bytes_total{edge=\"cam-2\",cloud=\"rack-a\",network=\"zmq-tcp\",\
                  pipeline=\"offload-full\",direction=\"upload\"}";
    let [by_edge, by_cloud] =
        ["peernet_link_", "peernet_link_cloud_"].map(|start| value(&first, &format!("{start}{upload}")));
    assert_eq!(by_edge, by_cloud);
    let retransmitted = &first["peernet_link_cloud_retransmitted_datagrams"].samples;
    assert!(!retransmitted.keys().any(|series| series.contains("\"upload\"")), "{retransmitted:?}");
    let stage_seconds = &first["peernet_pipeline_stage_seconds"].samples;
    assert!(
        !stage_seconds
            .keys()
            .any(|series| series.contains("offload-unrelated") && series.contains("\"upload\"")),
        "an unknown delay has a sample"
    );

    site.store_run_of_each_pipeline(50).await;
    let now = dashboard.clock.wall();
    site.report(now, now + Span::from_seconds(1)).await;
    let stored = value(&first, "peernet_aggregator_stored_nodes_total");
    dashboard
        .wait_until(|live_state| {
            live_state.totals.stored.nodes as f64 > stored
                && live_state.hosts.iter().all(|host| host.accounting.stored == host.stored.events)
        })
        .await;
    let second = parse_metrics(dashboard.get("/metrics").await.text());
    let mut grown = 0;
    for (name, family) in &first {
        assert_eq!(family.kind, second[name].kind);
        for (series, before) in family.samples.iter().filter(|_| family.kind == "counter") {
            let after = value(&second, series);
            assert!(after >= *before, "{series} went from {before} to {after}");
            grown += usize::from(after > *before);
        }
    }
    assert!(grown > 10, "{grown} counters grew");
    let stored_by_hosts = second["peernet_host_stored_events"].samples.values().sum::<f64>();
    assert_eq!(value(&second, "peernet_aggregator_stored_events_total"), stored_by_hosts);
}

#[tokio::test]
async fn documented_metrics_are_the_served_ones() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::full()]).await;
    let served = parse_metrics(dashboard.get("/metrics").await.text());
    let document = include_str!("../../../docs/metrics.md");
    let document = document.split("## Worth an alert").next().expect("the tables");
    let mut listed = BTreeSet::new();
    for row in document.lines().filter(|line| line.starts_with("| `peernet_")) {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [name, kind, unit, labels, help] = cells[..] else { panic!("{row} has not five cells") };
        let name = name.trim_matches('`');
        let family = name.strip_suffix("_total").unwrap_or(name);
        let served_family = served.get(family).unwrap_or_else(|| panic!("{name} is not served"));
        assert_eq!(kind == "counter", name.ends_with("_total"), "{row}");
        assert_eq!((kind, unit), (served_family.kind.as_str(), served_family.unit.as_str()), "{row}");
        assert_eq!(help, served_family.help, "{row}");
        let labels: BTreeSet<String> = labels
            .split(", ")
            .filter(|label| *label != "–")
            .map(|label| label.trim_matches('`').to_owned())
            .collect();
        assert!(
            served_family.samples.is_empty() || labels == served_family.labels,
            "{row}: {:?}",
            served_family.labels
        );
        assert!(listed.insert(family), "{row} occurs twice");
    }
    assert_eq!(listed.len(), served.len(), "listed {listed:?}, served {:?}", served.keys());
}

#[tokio::test]
async fn aggregator_without_hosts_has_metrics() {
    let dashboard = TestDashboard::empty().await;
    let families = parse_metrics(dashboard.get("/metrics").await.text());
    assert_eq!(families["peernet_aggregator_known_hosts"].samples["peernet_aggregator_known_hosts"], 0.0);
    assert!(families["peernet_host_produced_events"].samples.is_empty());
}
