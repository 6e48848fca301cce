//! Latency and throughput against payload, as `peernet plot` draws them.

use peernet_analysis::message_sizes::{MessageSketches, SizeSummary};
use peernet_analysis::payload_study::{DirectionMessages, Link, PayloadStudy, group_by_link, pooled_note};
use peernet_analysis::transfer::DirectionNodes;
use peernet_figures::drawing::Scaling;
use peernet_figures::payload_figures;
use peernet_logger::Slug;
use peernet_statistics::number::{NONE, bytes, count, milliseconds, throughput, throughput_between};
use peernet_store::RunSummary;

use super::Comparison;
use crate::picture::Picture;

/// Plots of the messages over one link, and their numbers.
pub(crate) struct PayloadPlots {
    /// Name of the link; empty if there is only one.
    pub link: String,
    pub latency: PayloadPlot,
    pub throughput: PayloadPlot,
    pub rows: Vec<SizeRow>,
}

/// Plot of a quantity against size, and notes on how to read the plot.
pub(crate) struct PayloadPlot {
    pub picture: Picture,
    pub notes: Vec<String>,
}

/// Messages of one size in one direction.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SizeRow {
    /// `upload` or `download`.
    pub direction: &'static str,
    /// Median size on the wire: payload and metadata.
    pub size: String,
    /// Number of messages.
    pub messages: String,
    /// Median delay, ms.
    pub delay: String,
    /// Throughput in MB/s, and its interval by the clock bounds.
    pub throughput: (String, Option<String>),
}

/// Returns the payload studies of the links whose messages differ enough in size.
pub(super) fn studies(comparison: &Comparison) -> Vec<PayloadStudy> {
    let runs = comparison.configurations.iter().flat_map(|one| one.runs.iter().map(move |run| (one, run)));
    let links = group_by_link(runs.map(|(one, run)| (link_of(run), run.experiment.as_ref(), (one, run))));
    let studies = links.into_iter().map(|(link, runs)| {
        let labels_of_runs: Vec<&[String]> = runs.iter().map(|(one, _)| one.values.as_slice()).collect();
        let directions = DirectionNodes::both().map(|nodes| {
            let sketches = runs.iter().filter_map(|(_, run)| sketches(comparison, run.number, nodes));
            DirectionMessages::from_sketches(nodes, sketches)
        });
        PayloadStudy::new(&link, directions, pooled_note(&comparison.axes, &labels_of_runs))
    });
    PayloadStudy::select_drawable(studies)
}

fn link_of(run: &RunSummary) -> Link {
    let placement = &run.placement;
    let cloud = placement.peer.as_ref().map_or("", Slug::as_str);
    Link {
        hosts: [run.host_name.as_str(), cloud].map(str::to_owned),
        network: [&placement.network, &placement.address].map(|text| text.clone().unwrap_or_default()),
    }
}

/// Returns the distributions of the messages that a run sent in one direction; `None` if it sent none.
fn sketches<'a>(comparison: &'a Comparison, run: i64, nodes: &DirectionNodes) -> Option<MessageSketches<'a>> {
    let statistics = comparison.statistics_by_run.get(&run)?;
    Some(MessageSketches {
        payload: statistics.summary(&nodes.payload)?,
        metadata: statistics.summary(&nodes.metadata),
        delay: statistics.summary(&nodes.delay),
        half_width: statistics.half_widths(&nodes.delay),
        ends: statistics.ends(&nodes.delay),
    })
}

/// Returns the plots of each link; empty if the messages of no direction differ enough in size.
pub(crate) fn payload(comparison: &Comparison) -> Vec<PayloadPlots> {
    let studies = studies(comparison);
    let has_several = studies.len() > 1;
    let plots = studies.iter().map(|study| {
        let [latency, throughput] = payload_figures(study).map(|scaling| plot(&scaling));
        let rows = study.directions.iter().flat_map(|one| one.sizes.iter().map(|size| row(one.name, size)));
        let link = if has_several { study.link_name.clone() } else { String::new() };
        PayloadPlots { link, latency, throughput, rows: rows.collect() }
    });
    plots.collect()
}

fn plot(scaling: &Scaling) -> PayloadPlot {
    let figure = scaling.figure();
    let series: Vec<&str> = scaling.series.iter().map(|series| series.name.as_str()).collect();
    let label = format!("{}. {}", figure.title, series.join("; "));
    let legend = Picture::of_legend(&figure.legend, "key plain points");
    let picture = figure
        .plots
        .iter()
        .fold(legend, |all, plot| all.followed_by(&Picture::of_plot(plot, "plot-with-axes sizes", &label)));
    PayloadPlot { picture, notes: figure.notes }
}

fn row(direction: &'static str, size: &SizeSummary) -> SizeRow {
    SizeRow {
        direction,
        size: bytes(size.wire_bytes).to_string(),
        messages: count(size.count),
        delay: milliseconds(size.median),
        throughput: (
            size.throughput.map_or_else(|| NONE.to_owned(), throughput),
            size.throughput_bounds.map(throughput_between),
        ),
    }
}
