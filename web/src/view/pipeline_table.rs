//! Table of the pipelines in the last minute: stage bars on one scale, with their numbers.

use peernet_aggregator::{PipelineSnapshot, Window};
use peernet_clock::Direction;
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{NONE, count, percent, rate, total_ms};
use peernet_statistics::{MIN_VALUES_FOR_P95, MIN_VALUES_FOR_P99};
use peernet_store::QuantityStatistics;
use peernet_stream::PipelineState;

use super::chip::{Chip, Tone};
use super::clocks::ClockCell;
use super::place;
use super::speed;
use super::stack::Stack;
use crate::look;
use crate::picture::Picture;

/// Whiskers extend the axis only up to this multiple of the longest bar.
const MAX_AXIS_RATIO: f64 = 2.0;
/// Approximate number of ticks of a scale.
const TICKS: usize = 6;
/// Length of the window of all numbers, seconds: the shortest window with enough iterations for a p99 at 5 Hz.
// Bars, quantiles and whiskers come from one window, because numbers of different windows cannot be compared.
const WINDOW_S: u32 = 60;

/// Bars on a shared scale.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PipelineTable {
    pub axis: Picture,
    /// Axis below each bar, for phones.
    pub small_axis: Picture,
    pub rows: Vec<PipelineRow>,
    /// The stages that any of the rows has, except `unattributed`, which always has a column in the table view.
    pub columns: Vec<&'static str>,
    /// `true` if a pipeline has a deadline.
    pub has_deadlines: bool,
}

/// One pipeline.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PipelineRow {
    pub name: String,
    pub href: String,
    /// Hosts of the pipeline, and its model or its network and payload: `cam-2 → rack-a · zmq-tcp · 1.23 MB`.
    pub placement: String,
    /// State of the pipeline; `None` while it runs.
    pub state: Option<Chip>,
    /// The mean stages as a bar, with whiskers to p95 and p99.
    pub bar: Picture,
    pub p50: Cell,
    pub p95: Cell,
    pub p99: Cell,
    pub rate: String,
    /// Share of iterations without success, percent.
    pub failed: Cell,
    /// The miss rate, percent.
    pub missed: Cell,
    /// Speed while sending up, MB/s.
    pub up: Cell,
    /// Speed while sending down, MB/s.
    pub down: Cell,
    /// Traffic up and down, MB/s.
    pub traffic: Cell,
    pub clock: ClockCell,
    /// Means in the order of the table's columns, and the mean of `unattributed`, ms.
    pub stages: Vec<String>,
    pub total: String,
}

/// Text of a table's cell, and an explanation that is shown as a tooltip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Cell {
    pub text: String,
    pub title: Option<String>,
}

impl Cell {
    pub(crate) fn new(text: String) -> Self {
        Self { text, title: None }
    }

    /// Returns a dash with the reason why there is no value.
    pub(crate) fn none(why: impl Into<String>) -> Self {
        Self { text: NONE.to_owned(), title: Some(why.into()) }
    }
}

/// Returns the chip of a state other than running.
pub(crate) fn state_chip(state: &PipelineState) -> Option<Chip> {
    let (tone, icon) = match state {
        PipelineState::Running => return None,
        PipelineState::Starting => (Tone::Quiet, "stale"),
        PipelineState::Waiting(_) | PipelineState::Away => (Tone::Warn, "stale"),
        PipelineState::Finished => (Tone::Quiet, "ok"),
        PipelineState::Failed(_) => (Tone::Bad, "failed"),
    };
    Some(Chip::new(tone, icon, state.name()))
}

/// Returns the reason why a pipeline does not run, in words: `waits: the cloud loads its model`.
pub(crate) fn state_reason(state: &PipelineState) -> Option<String> {
    let verb = match state {
        PipelineState::Failed(_) => "stopped",
        PipelineState::Waiting(_) => "waits",
        PipelineState::Starting | PipelineState::Running | PipelineState::Finished | PipelineState::Away => {
            return None;
        }
    };
    state.reason().map(|reason| format!("{verb}: {reason}"))
}

/// Returns a quantile of `total`, and its cell. Without a value the cell explains that the quantile needs
/// `min_iterations` iterations.
fn quantile(
    total: Option<&QuantityStatistics>,
    min_iterations: u64,
    quantile_of: fn(&QuantityStatistics) -> Option<f64>,
) -> (Option<f64>, Cell) {
    let value = total.and_then(quantile_of);
    let cell = value.map_or_else(
        || {
            let iterations = total.map_or(0, |total| total.count);
            Cell::none(format!(
                "needs {min_iterations} iterations; the last minute has {}",
                count(iterations)
            ))
        },
        |value| Cell::new(total_ms(value)),
    );
    (value, cell)
}

impl PipelineTable {
    /// Returns the pipelines as they were in the last minute.
    pub(crate) fn new(pipelines: &[&PipelineSnapshot]) -> Self {
        let windows: Vec<(&PipelineSnapshot, &Window)> =
            pipelines.iter().filter_map(|one| Some((*one, one.window(WINDOW_S)?))).collect();
        let stacks: Vec<Stack> = windows.iter().map(|(_, window)| Stack::of_window(window)).collect();
        // A whisker that is far longer than the bars would compress the bars. Such a whisker is cut at the end of the
        // axis, and the table shows its value.
        let longest = stacks.iter().map(Stack::end_ms).fold(0.0, f64::max);
        let reach = windows.iter().map(|(_, window)| {
            window
                .value(&stage::TOTAL)
                .map_or(0.0, |total| total.p99.or(total.p95).unwrap_or(total.p50) * 1e3)
        });
        let scale = Scale::up_to(reach.fold(0.0, f64::max).min(MAX_AXIS_RATIO * longest).max(longest), TICKS);
        let has_part =
            |name: &&str| stacks.iter().flat_map(|stack| &stack.parts).any(|part| part.name == **name);
        let columns: Vec<&'static str> =
            look::parts().filter(|name| *name != "unattributed").filter(has_part).collect();
        let rows = windows
            .iter()
            .zip(stacks)
            .map(|((pipeline, window), stack)| PipelineRow::new(pipeline, window, &stack, scale, &columns));
        Self {
            axis: Picture::milliseconds_axis(&scale, ""),
            small_axis: Picture::milliseconds_axis(&scale, "small"),
            rows: rows.collect(),
            columns,
            has_deadlines: windows.iter().any(|(_, window)| window.miss_rate.is_some()),
        }
    }
}

impl PipelineRow {
    fn new(
        pipeline: &PipelineSnapshot,
        window: &Window,
        stack: &Stack,
        scale: Scale,
        columns: &[&'static str],
    ) -> Self {
        let host = pipeline.host_name.as_str();
        let total = window.value(&stage::TOTAL);
        let (p95, p95_cell) = quantile(total, MIN_VALUES_FOR_P95, |total| total.p95);
        let (p99, p99_cell) = quantile(total, MIN_VALUES_FOR_P99, |total| total.p99);
        let part = |name: &str| stack.parts.iter().find(|part| part.name == name);
        let format = stack.duration_format();
        let mean = |name: &&'static str| {
            part(name).map_or_else(|| NONE.to_owned(), |part| format.duration(part.seconds))
        };
        Self {
            name: pipeline.pipeline.to_string(),
            href: place::pipeline_href(host, pipeline.pipeline.as_str()),
            placement: format!(
                "{} · {}",
                place::route(host, &pipeline.placement),
                place::details(&pipeline.placement, Some(window))
            ),
            state: state_chip(&pipeline.state),
            bar: stack.bar("stages", (p95, p99), scale),
            p50: total.map_or_else(
                || Cell::none("no successful iteration in this time"),
                |total| Cell::new(total_ms(total.p50)),
            ),
            p95: p95_cell,
            p99: p99_cell,
            rate: rate(window.rate_hz),
            failed: window
                .failed_fraction
                .map_or_else(|| Cell::none("no iteration in this time"), |failed| Cell::new(percent(failed))),
            missed: window
                .miss_rate
                .map_or_else(|| Cell::none("no deadline"), |missed| Cell::new(percent(missed))),
            up: speed::cell(pipeline.placement.kind, window, Direction::Up),
            down: speed::cell(pipeline.placement.kind, window, Direction::Down),
            traffic: speed::traffic(pipeline.placement.kind, window),
            clock: ClockCell::of(pipeline.placement.kind, &window.bounds),
            stages: columns.iter().map(mean).chain([mean(&"unattributed")]).collect(),
            total: stack.total.map_or_else(|| NONE.to_owned(), |total| format.duration(total.mean)),
        }
    }
}
