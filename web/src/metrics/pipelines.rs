//! Metrics of pipelines.

use peernet_aggregator::{PipelineSnapshot, Window};
use peernet_analysis::actuator_results::{ActuatorResults, EPISODE_SUCCESS, SUPERSEDED};
use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::Direction;
use peernet_logger::stage;
use peernet_store::QuantityStatistics;
use peernet_stream::PipelineState;

use super::scrape::Scrape;
use super::table::{Sample, Sink};
use crate::view::speed;

/// Lengths of the windows in seconds, with the values of their label.
const WINDOWS: [(u32, &str); 2] = [(10, "10s"), (60, "60s")];

/// Returns the values of the labels `host` and `pipeline`.
fn label_values(pipeline: &PipelineSnapshot) -> [&str; 2] {
    [pipeline.host_name.as_str(), pipeline.pipeline.as_str()]
}

/// Writes whether each pipeline measures.
pub(super) fn write_running(scrape: &Scrape, sink: &mut Sink<'_>) {
    for pipeline in &scrape.pipelines {
        sink(&label_values(pipeline), Sample::from_bool(pipeline.state == PipelineState::Running));
    }
}

/// Writes the number of iterations by outcome.
pub(super) fn write_iterations(scrape: &Scrape, sink: &mut Sink<'_>) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        for (seconds, label) in WINDOWS {
            let Some(window) = pipeline.window(seconds) else { continue };
            let counts = window.counts;
            let outcomes = [
                ("ok", counts.ok),
                ("failed", counts.failed),
                ("lost", counts.lost),
                ("timeout", counts.timeout),
            ];
            for (outcome, count) in outcomes {
                // The sample is a gauge and not a counter, because the count within a window can also fall.
                sink(&[host, name, outcome, label], Sample::Size(count));
            }
        }
    }
}

/// Writes the iterations per second.
pub(super) fn write_rate(scrape: &Scrape, sink: &mut Sink<'_>) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        for (seconds, label) in WINDOWS {
            if let Some(window) = pipeline.window(seconds) {
                sink(&[host, name, label], Sample::Value(window.rate_hz));
            }
        }
    }
}

/// Writes the shares of missed deadlines.
pub(super) fn write_missed(scrape: &Scrape, sink: &mut Sink<'_>) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        for (seconds, label) in WINDOWS {
            if let Some(rate) = pipeline.window(seconds).and_then(|window| window.miss_rate) {
                sink(&[host, name, label], Sample::Value(rate));
            }
        }
    }
}

/// Writes the numbers of superseded answers.
pub(super) fn write_superseded(scrape: &Scrape, sink: &mut Sink<'_>) {
    write_actuator_result(scrape, sink, SUPERSEDED, |results| Some(Sample::Size(results.superseded)));
}

/// Writes the success rates of episodes.
pub(super) fn write_episode_success(scrape: &Scrape, sink: &mut Sink<'_>) {
    write_actuator_result(scrape, sink, EPISODE_SUCCESS, |results| {
        Some(Sample::Value(results.success?.rate))
    });
}

/// Writes the result of the actuator that belongs to the value `value_name`.
fn write_actuator_result(
    scrape: &Scrape,
    sink: &mut Sink<'_>,
    value_name: &str,
    sample_of: impl Fn(ActuatorResults) -> Option<Sample>,
) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        for (seconds, label) in WINDOWS {
            let Some(statistics) = pipeline.window(seconds).and_then(|window| window.value(value_name))
            else {
                continue;
            };
            let QuantityStatistics { count, mean, std, .. } = *statistics;
            // Only the field of this value is read, so the other results may be computed from the same statistics.
            if let Some(sample) = sample_of(ActuatorResults::from_statistics(|_| Some((count, mean, std)))) {
                sink(&[host, name, label], sample);
            }
        }
    }
}

/// Writes the quantiles of each standard stage. User-defined names are omitted, because their number is not bounded.
pub(super) fn write_stages(scrape: &Scrape, sink: &mut Sink<'_>) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        let Some(window) = pipeline.window(60) else { continue };
        for stage in stage::ORDER.iter().chain(&[stage::TOTAL, stage::UNATTRIBUTED]) {
            let Some(statistics) = window.value(stage) else { continue };
            let quantiles =
                [("0.5", Some(statistics.p50)), ("0.95", statistics.p95), ("0.99", statistics.p99)];
            for (quantile, value) in quantiles {
                if let Some(value) = value {
                    sink(&[host, name, stage, quantile], Sample::Value(value));
                }
            }
        }
    }
}

/// Writes the speeds while sending.
pub(super) fn write_speed(scrape: &Scrape, sink: &mut Sink<'_>) {
    write_directions(scrape, sink, |window, direction| {
        Some(speed::known_speed(&window.transfers, &window.bounds, direction)?.bits_per_second)
    });
}

/// Writes the traffic over wall time.
pub(super) fn write_traffic(scrape: &Scrape, sink: &mut Sink<'_>) {
    write_directions(scrape, sink, speed::direction_traffic);
}

fn write_directions(
    scrape: &Scrape,
    sink: &mut Sink<'_>,
    value_of: impl Fn(&Window, Direction) -> Option<f64>,
) {
    for pipeline in &scrape.pipelines {
        let [host, name] = label_values(pipeline);
        let Some(window) = pipeline.window(60) else { continue };
        for direction in Direction::ALL {
            if let Some(value) = value_of(window, direction) {
                sink(&[host, name, DirectionNodes::of(direction).delay.as_str()], Sample::Value(value));
            }
        }
    }
}
