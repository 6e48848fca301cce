//! Distributions of the total and the longest stages of a run.

use peernet_logger::stage;

use super::columns::{count_note, heading, too_large_note, unit, values, with_name};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Cumulative, CumulativeCurve, Unit};
use crate::look::{INK, Mark, Style, stage as look};
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;

/// Number of the longest stages that are shown beside the total.
const STAGE_CURVES: usize = 4;
/// Width of lines, points; the total's is stronger.
const LINE_WIDTH: f64 = 0.9;
const TOTAL_LINE_WIDTH: f64 = 1.2;

/// Returns a curve for the total and each of the longest stages, or the curve of a column.
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
            title: with_name(&title, &record.title),
            unit: unit(&record.units, column, &title),
            notes: notes(rows, &[column], &curve.values),
            curves: vec![curve],
        };
        return Ok(vec![Drawing::new(format!("{column}-cumulative"), AnyFigure::Cumulative(figure))]);
    }
    let totals = ["total", "stages-total"].map(|column| (column, values(rows, column)));
    let total = totals.into_iter().find(|(_, values)| !values.is_empty());
    let (total_column, total_values) = total.ok_or(MissingData::Total)?;
    let stages = stage::ORDER.into_iter().map(|name| (values(rows, &name), name));
    let mut stages: Vec<_> =
        stages.filter(|(values, _)| values.median().is_some_and(|median| median > 0.0)).collect();
    let sum = |values: &SortedValues| values.values().iter().sum::<f64>();
    stages.sort_by(|a, b| sum(&b.0).total_cmp(&sum(&a.0)));
    let shorter: Vec<String> = stages.iter().skip(STAGE_CURVES).map(|(_, name)| name.to_string()).collect();
    stages.truncate(STAGE_CURVES);
    stages.sort_by_key(|(_, name)| stage::ORDER.iter().position(|other| other == name));
    let mut notes = notes(rows, &[total_column], &total_values);
    if !shorter.is_empty() {
        notes.push(format!("shorter stages, not drawn: {}", shorter.join(", ")));
    }
    let stage_curves =
        stages.into_iter().enumerate().map(|(number, (values, name))| curve(&name, values, number));
    let curves = std::iter::once(curve(total_column, total_values, 0)).chain(stage_curves).collect();
    let figure = Cumulative {
        title: with_name("Cumulative distributions", &record.title),
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

/// Returns the curve of a stage in the stage's colour with the mark of this number, or the curve of a total in ink.
fn curve(name: &str, values: SortedValues, number: usize) -> CumulativeCurve {
    let look = look(name);
    let (line, mark) = if !look.has_colour() {
        (
            Style::line("strong", INK.light, TOTAL_LINE_WIDTH),
            (Mark::Cross, Style::line("strong", INK.light, LINE_WIDTH)),
        )
    } else {
        (look.line(LINE_WIDTH), (Mark::ALL[number % Mark::ALL.len()], look.mark()))
    };
    CumulativeCurve { name: name.to_owned(), line, mark, values }
}
