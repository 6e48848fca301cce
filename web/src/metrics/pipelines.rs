//! Metrics of pipelines.

use peernet_aggregator::{PipelineSnapshot, Window};
use peernet_analysis::transfer::Transfer;
use peernet_logger::stage;
use peernet_stream::PipelineState;

use super::scrape::Scrape;
use super::table::{Sample, Sink};

/// Windows in seconds, with the values of their label.
const WINDOWS: [(u32, &str); 2] = [(10, "10s"), (60, "60s")];

fn names(one: &PipelineSnapshot) -> [&str; 2] {
    [one.host_name.as_str(), one.pipeline.as_str()]
}

/// Returns whether each measures.
pub(super) fn running(scrape: &Scrape, to: &mut Sink<'_>) {
    for one in &scrape.pipelines {
        to(&names(one), Sample::truth(one.state == PipelineState::Running));
    }
}

/// Iterations by outcome.
pub(super) fn iterations(scrape: &Scrape, to: &mut Sink<'_>) {
    for one in &scrape.pipelines {
        let [host, name] = names(one);
        for (seconds, label) in WINDOWS {
            let Some(window) = one.window(seconds) else { continue };
            let counts = window.counts;
            let outcomes = [
                ("ok", counts.ok),
                ("failed", counts.failed),
                ("lost", counts.lost),
                ("timeout", counts.timeout),
            ];
            for (outcome, many) in outcomes {
                to(&[host, name, outcome, label], Sample::Size(many));
            }
        }
    }
}

/// Iterations per second.
pub(super) fn rate(scrape: &Scrape, to: &mut Sink<'_>) {
    for one in &scrape.pipelines {
        let [host, name] = names(one);
        for (seconds, label) in WINDOWS {
            if let Some(window) = one.window(seconds) {
                to(&[host, name, label], Sample::Value(window.rate_hz));
            }
        }
    }
}

/// Shares of missed deadlines.
pub(super) fn missed(scrape: &Scrape, to: &mut Sink<'_>) {
    for one in &scrape.pipelines {
        let [host, name] = names(one);
        for (seconds, label) in WINDOWS {
            if let Some(rate) = one.window(seconds).and_then(|window| window.miss_rate) {
                to(&[host, name, label], Sample::Value(rate));
            }
        }
    }
}

/// Quantiles per stage. Names that users added are left out: they are not bounded.
pub(super) fn stages(scrape: &Scrape, to: &mut Sink<'_>) {
    for one in &scrape.pipelines {
        let [host, name] = names(one);
        let Some(window) = one.window(60) else { continue };
        for stage in stage::ORDER.iter().chain(&[stage::TOTAL, stage::UNATTRIBUTED]) {
            let Some(figures) = window.value(stage) else { continue };
            let quantiles = [("0.5", Some(figures.p50)), ("0.95", figures.p95), ("0.99", figures.p99)];
            for (quantile, value) in quantiles {
                if let Some(value) = value {
                    to(&[host, name, stage, quantile], Sample::Value(value));
                }
            }
        }
    }
}

/// Speeds while sending.
pub(super) fn speed(scrape: &Scrape, to: &mut Sink<'_>) {
    each_way(scrape, to, |_, transfer| transfer.speed());
}

/// Traffic over wall time.
pub(super) fn traffic(scrape: &Scrape, to: &mut Sink<'_>) {
    each_way(scrape, to, |window, transfer| transfer.traffic(window.covered_s));
}

fn each_way(scrape: &Scrape, to: &mut Sink<'_>, of: impl Fn(&Window, Transfer) -> Option<f64>) {
    for one in &scrape.pipelines {
        let [host, name] = names(one);
        let Some(window) = one.window(60) else { continue };
        for (way, transfer) in [("upload", window.transfers.up), ("download", window.transfers.down)] {
            if let Some(value) = transfer.and_then(|transfer| of(window, transfer)) {
                to(&[host, name, way], Sample::Value(value));
            }
        }
    }
}
