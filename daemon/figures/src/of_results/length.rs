//! Figure of latency against the length of answers.

use super::Columns;
use super::columns::{count_note, heading, is_drawable, too_large_note, unit};
use super::missing_data::MissingData;
use super::replayed::title_of_column;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Lengths, Unit};
use peernet_analysis::answer_length::{
    Growth, LATENCY, NO_USAGE, answer_length, is_tokens, lacks_usage, tokens_of_column, varies,
};
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{RowRef, Rows};

/// Symbol of the unit in which latencies are shown.
const MILLISECONDS: &str = "ms";

/// Returns whether the lengths of the answers of a run are counted in tokens, like those of a language model.
pub(super) fn has_tokens(rows: &Rows) -> bool {
    rows.columns_in_statistics().any(is_tokens)
}

/// Returns the figure with a point for the length and the latency of each answer.
pub(super) fn drawings(
    record: &RunRecord,
    rows: &Rows,
    columns: &Columns,
) -> Result<Vec<Drawing>, MissingData> {
    let columns_with_values: Vec<&str> = rows.columns_in_statistics().collect();
    // `answer_length` returns the name of a column. Without a column of tokens, this is `download-bytes`.
    let x =
        columns.x.clone().unwrap_or_else(|| answer_length(columns_with_values.iter().copied()).to_owned());
    // If a column of lengths was named, it does not matter that the server reports no numbers of tokens.
    let lacks_usage = columns.x.is_none() && lacks_usage(columns_with_values.iter().copied());
    // If the model runs on the robot, no answer is sent over a network. The column `download-bytes` then has no
    // positive value and is no substitute for a length.
    let has_lengths = rows.values_in_statistics(&x).any(|value| value > 0.0);
    let substitute = has_lengths.then(|| x.clone());
    // Without numbers of tokens, their absence is the reason that helps most.
    let reason = |missing| {
        if lacks_usage { MissingData::TokenCounts { substitute: substitute.clone() } } else { missing }
    };
    let y = columns.y.clone().unwrap_or_else(|| LATENCY.to_owned());
    let rows_in_statistics = rows.iter().filter(|row| row.is_in_statistics());
    let point = |row: RowRef<'_>| Some((row.value(&x)?, row.value(&y)?));
    let points: Vec<(f64, f64)> =
        rows_in_statistics.filter_map(point).filter(|(x, y)| is_drawable(*x) && is_drawable(*y)).collect();
    if points.is_empty() {
        return Err(reason(MissingData::Columns { x: x.clone(), y }));
    }
    let (shortest, longest) = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), (length, _)| (lo.min(*length), hi.max(*length)));
    if longest <= shortest {
        return Err(reason(MissingData::SameLength { x: x.clone(), length: shortest }));
    }
    // A column that was named is drawn even if its lengths are similar.
    if columns.x.is_none() && !varies(shortest, longest) {
        return Err(reason(MissingData::SimilarLength { x: x.clone() }));
    }
    let (x_unit, x_name) = match tokens_of_column(&x) {
        Some(tokens) => (Unit { title: heading(tokens), symbol: "".into(), per_si: 1.0 }, tokens),
        None => (unit(&record.units, &x, &heading(&x)), x.as_str()),
    };
    let growth = Growth::from_iterations(&points);
    let line = growth.and_then(|growth| growth.line());
    let y_unit = unit(&record.units, &y, &heading(&y));
    // The sentences on the growth say "takes … ms", so they are left out if the vertical axis does not show a latency.
    let described_growth = growth.ok().filter(|_| y_unit.symbol == MILLISECONDS && line.is_ok());
    let title = format!("{} against {}", heading(&y), x_name.replace(['-', '_'], " "));
    let lengths = Lengths {
        title: title_of_column(&title, &y, record),
        x: x_unit,
        y: y_unit,
        stage: y.clone(),
        notes: std::iter::once(count_note(&rows.iter(), points.len()))
            .chain(too_large_note(rows.iter(), &[x.as_str(), y.as_str()]))
            .chain(line.err().map(|no_line| format!("no line: {no_line}")))
            .chain(described_growth.map(|growth| growth.describe_slope(&x)))
            .chain(described_growth.and_then(|growth| growth.describe_intercept()))
            .chain(lacks_usage.then(|| NO_USAGE.to_owned()))
            .collect(),
        line: line.ok(),
        points,
    };
    Ok(vec![Drawing::new("length", AnyFigure::Lengths(lengths))])
}
