//! Response length against latency.

use super::Columns;
use super::columns::{count_note, heading, is_drawable, too_large_note, unit, with_run_name};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::Lengths;
use peernet_analysis::answer_length::{LATENCY, answer_length, varies};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::RowRef;

/// Returns the figure of length and latency of each answer.
pub(super) fn drawings(run: &Loaded, columns: &Columns) -> Result<Vec<Drawing>, MissingData> {
    let columns_with_values =
        run.rows.names().iter().filter(|name| run.rows.counted_values(name).next().is_some());
    let x = columns
        .x
        .clone()
        .unwrap_or_else(|| answer_length(columns_with_values.map(|name| &**name)).to_owned());
    let y = columns.y.clone().unwrap_or_else(|| LATENCY.to_owned());
    let counted_rows = run.rows.iter().filter(|row| row.is_counted());
    let point = |row: RowRef<'_>| Some((row.value(&x)?, row.value(&y)?));
    let points: Vec<(f64, f64)> =
        counted_rows.filter_map(point).filter(|(x, y)| is_drawable(*x) && is_drawable(*y)).collect();
    if points.is_empty() {
        return Err(MissingData::Columns { x, y });
    }
    let (shortest, longest) = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), (length, _)| (lo.min(*length), hi.max(*length)));
    if longest <= shortest {
        return Err(MissingData::SameLength { x, length: shortest });
    }
    if columns.x.is_none() && !varies(shortest, longest) {
        return Err(MissingData::SimilarLength { x });
    }
    let lengths = Lengths {
        title: with_run_name(
            &format!("{} against {}", heading(&y), x.replace(['-', '_'], " ")),
            &run.record.title,
        ),
        x: unit(&run.record.units, &x, &heading(&x)),
        y: unit(&run.record.units, &y, &heading(&y)),
        stage: y.clone(),
        notes: std::iter::once(count_note(&run.rows.iter(), points.len()))
            .chain(too_large_note(run.rows.iter(), &[x.as_str(), y.as_str()]))
            .collect(),
        points,
    };
    Ok(vec![Drawing::new("length", AnyFigure::Lengths(lengths))])
}
