//! Figures of the cumulative distributions of the totals of configurations.

use peernet_statistics::number;

use super::columns::{excluded_note, too_large_note, values};
use super::configuration_groups::{ConfigurationGroups, rows_in_statistics};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Cumulative, CumulativeCurve, MAX_CURVES, Unit};
use crate::look::series;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::total_column::TotalColumn;

/// Width of a curve, points.
const LINE_WIDTH: f64 = 1.0;

/// Returns figures with one curve for each configuration, at most [`MAX_CURVES`] in a figure. Repeats of a
/// configuration are pooled.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let all_rows = || groups.iter().flat_map(|(_, runs)| rows_in_statistics(runs));
    let total = TotalColumn::from_rows(all_rows());
    let groups_with_total: Vec<(&String, SortedValues)> = groups
        .iter()
        .map(|(label, runs)| (label, values(runs.iter().flat_map(|run| &run.rows), total.name())))
        .filter(|(_, values)| !values.is_empty())
        .collect();
    if groups_with_total.is_empty() {
        return Err(MissingData::Total);
    }
    let omitted_groups = groups.len() - groups_with_total.len();
    let mut left_out = Vec::new();
    if omitted_groups > 0 {
        let configurations = number::counted(omitted_groups as u64, "configuration");
        left_out.push(format!("left out: {configurations} without a total"));
    }
    let mut notes = vec![format!("configurations: {} · {}", axes.join(", "), total.description())];
    notes.extend(excluded_note(&runs.iter().flat_map(|run| &run.rows)));
    notes.extend(too_large_note(all_rows(), &[total.name()]));
    notes.extend(left_out.iter().cloned());
    let drawings = groups_with_total.chunks(MAX_CURVES).enumerate().map(|(index, chunk)| {
        let suffix = if index == 0 { String::new() } else { format!("-{}", index + 1) };
        let count_range = number::range_of_counts(chunk.iter().map(|(_, values)| values.len() as u64));
        let figure = Cumulative {
            title: "Total by configuration".to_owned(),
            unit: Unit::milliseconds("Total"),
            curves: chunk
                .iter()
                .enumerate()
                .map(|(series_index, group)| curve(group, series_index))
                .collect(),
            notes: count_range
                .map(|counts| format!("n = {counts} each"))
                .into_iter()
                .chain(notes.iter().cloned())
                .collect(),
        };
        let drawing = Drawing::new(format!("totals{suffix}"), AnyFigure::Cumulative(figure));
        // All figures show the notes on what is left out. Only the first figure passes the notes on to the terminal, so
        // that each note is printed once.
        if index == 0 { drawing.with_left_out(left_out.clone()) } else { drawing }
    });
    Ok(drawings.collect())
}

/// Returns the curve of a configuration in the look of the series with this index.
fn curve((label, values): &(&String, SortedValues), series_index: usize) -> CumulativeCurve {
    let look = series(series_index);
    let mark = (look.mark, look.marks());
    CumulativeCurve { name: (*label).clone(), line: look.line(LINE_WIDTH), mark, values: values.clone() }
}
