//! Figure of the cumulative distributions of the total and the longest stages of a run.

use super::columns::{count_note, heading, too_large_note, unit, values};
use super::longest_stages::LongestStages;
use super::missing_data::MissingData;
use super::replayed::{title_of_column, title_with_marked_name};
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Cumulative, CumulativeCurve, Unit};
use crate::look::{INK, Mark, Style, stage as look};
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_analysis::total_column::TotalColumn;

/// Width of the line of a stage, points.
const LINE_WIDTH: f64 = 0.9;
/// Width of the line of the total, points.
const TOTAL_LINE_WIDTH: f64 = 1.2;

/// Returns the figure with a curve for the total and a curve for each of the longest stages. If a column is given,
/// returns the figure with the curve of this column instead.
pub(super) fn drawings(
    record: &RunRecord,
    rows: &Rows,
    column: Option<&str>,
) -> Result<Vec<Drawing>, MissingData> {
    if let Some(column) = column {
        let title = heading(column);
        let curve = curve(column, values(rows, column), 0);
        if curve.values.is_empty() {
            return Err(MissingData::Column(column.to_owned()));
        }
        let figure = Cumulative {
            title: title_of_column(&title, column, record),
            unit: unit(&record.units, column, &title),
            notes: notes(rows, &[column], &curve.values),
            curves: vec![curve],
        };
        return Ok(vec![Drawing::new(format!("{column}-cumulative"), AnyFigure::Cumulative(figure))]);
    }
    let total_column = TotalColumn::from_rows(rows).name();
    let total_values =
        Some(values(rows, total_column)).filter(|values| !values.is_empty()).ok_or(MissingData::Total)?;
    let stages = LongestStages::new(rows);
    let mut notes = notes(rows, &[total_column], &total_values);
    notes.extend(stages.shorter_note());
    let stage_curves =
        stages.longest.iter().enumerate().map(|(index, name)| curve(name, values(rows, name), index));
    let curves = std::iter::once(curve(total_column, total_values, 0)).chain(stage_curves).collect();
    let figure = Cumulative {
        title: title_with_marked_name("Cumulative distributions", record),
        unit: Unit::milliseconds("Latency"),
        curves,
        notes,
    };
    Ok(vec![Drawing::new("cumulative", AnyFigure::Cumulative(figure))])
}

fn notes(rows: &Rows, columns: &[&str], values: &SortedValues) -> Vec<String> {
    let count_note = count_note(&rows.iter(), values.len());
    std::iter::once(count_note).chain(too_large_note(rows.iter(), columns)).collect()
}

/// Returns the curve of a stage in the stage's colour with the mark of this index, or the curve of another quantity,
/// such as the total, in ink.
fn curve(name: &str, values: SortedValues, mark_index: usize) -> CumulativeCurve {
    let look = look(name);
    let (line, mark) = if look.has_colour() {
        (look.line(LINE_WIDTH), (Mark::OF_SERIES[mark_index % Mark::OF_SERIES.len()], look.mark()))
    } else {
        (
            Style::line("strong", INK.light, TOTAL_LINE_WIDTH),
            (Mark::Cross, Style::line("strong", INK.light, LINE_WIDTH)),
        )
    };
    CumulativeCurve { name: name.to_owned(), line, mark, values }
}
