//! Figures of latency and of throughput against payload, for runs with payloads of several sizes.

use super::columns::{excluded_note, too_large_note};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::of_messages::payload_figures;
use peernet_analysis::compare::Configurations;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::payload_study::{DirectionMessages, Link, PayloadStudy, group_by_link, pooled_note};
use peernet_analysis::rows::RowRef;
use peernet_analysis::transfer::DirectionNodes;

/// Returns two figures for each link: the figure of latency and the figure of throughput.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let configurations = Configurations::from_runs(runs);
    let drawn_nodes = DirectionNodes::both().map(|nodes| [&nodes.delay, &nodes.payload, &nodes.metadata]);
    let drawn_columns: Vec<&str> = drawn_nodes.as_flattened().iter().map(|name| name.as_str()).collect();
    let experiment_position = |index: usize| runs[index].record.experiment.as_ref();
    let links = group_by_link(
        (0..runs.len()).map(|index| (Link::from(&runs[index].record), experiment_position(index), index)),
    );
    let studies = links.into_iter().map(|(link, indexes): (Link, Vec<usize>)| {
        let rows = indexes.iter().flat_map(|index| &runs[*index].rows);
        let labels: Vec<&[String]> =
            indexes.iter().map(|index| configurations.labels[*index].as_slice()).collect();
        let notes = [
            pooled_note(&configurations.axes, &labels),
            excluded_note(&rows),
            too_large_note(rows.clone(), &drawn_columns),
        ];
        let in_statistics: Vec<RowRef<'_>> = rows.filter(RowRef::is_in_statistics).collect();
        let directions =
            DirectionNodes::both().map(|nodes| DirectionMessages::from_rows(nodes, &in_statistics));
        PayloadStudy::new(&link, directions, notes.into_iter().flatten())
    });
    let studies = PayloadStudy::select_drawable(studies);
    if studies.is_empty() {
        return Err(MissingData::MessageSizes);
    }
    let drawings = studies.into_iter().enumerate().flat_map(|(index, study)| {
        let suffix = if index == 0 { String::new() } else { format!("-{}", index + 1) };
        let [latency, throughput] = payload_figures(&study);
        let drawing =
            |name: &str, figure| Drawing::new(format!("payload-{name}{suffix}"), AnyFigure::Scaling(figure));
        // Both figures show the notes on what is left out. Only the figure of latency passes the notes on to the
        // terminal, so that each note is printed once.
        [drawing("latency", latency).with_left_out(study.missing), drawing("throughput", throughput)]
    });
    Ok(drawings.collect())
}
