//! Columns of results as quantities of figures.

use peernet_statistics::number::fixed;

use crate::drawing::Unit;
use peernet_analysis::order::SortedValues;
use peernet_analysis::rows::{RowRef, Rows, Units};
use peernet_analysis::summary::Scale;

/// Beyond this nothing was measured: a year is 3·10⁷ s, and the fastest links carry 10¹⁵ bit/s.
const MAX_MAGNITUDE: f64 = 1e18;

/// Returns whether a number can be drawn in a figure.
pub(super) fn is_drawable(value: f64) -> bool {
    value.abs() <= MAX_MAGNITUDE
}

/// Returns a note on the count of numbers in these columns that are too large to be drawn; `None` if there are none.
pub(super) fn too_large_note<'a>(rows: impl Iterator<Item = RowRef<'a>>, columns: &[&str]) -> Option<String> {
    let counted = rows.filter(|row| row.is_counted());
    let numbers = counted.flat_map(|row| columns.iter().filter_map(move |column| row.value(column)));
    let count = numbers.filter(|value| value.is_finite() && !is_drawable(*value)).count();
    (count > 0).then(|| {
        format!("not drawn, beyond ±10¹⁸: {}", peernet_statistics::number::counted(count as u64, "number"))
    })
}

/// Returns a column's numbers that can be drawn, in the rows that count.
pub(super) fn values(rows: &Rows, column: &str) -> SortedValues {
    rows.counted_values(column).filter(|value| is_drawable(*value)).collect()
}

/// Returns the unit in which a column's numbers are shown: ms for a time, and so on; for a quantity that a run logged itself, the unit that
/// it gave.
pub(super) fn unit(units: &Units, column: &str, what: &str) -> Unit {
    let plain = |title: String, symbol: String| Unit { title, symbol: symbol.into(), per_si: 1.0 };
    if ["iteration", "episode", "step"].contains(&column) {
        return plain(what.to_owned(), String::new());
    }
    let logged = units.of(column);
    match Scale::for_column(column, logged) {
        Scale::Milliseconds => Unit::milliseconds(what),
        Scale::MegabytesPerSecond => Unit::megabytes_per_second(what),
        Scale::Bytes => plain(format!("{}, bytes", what.trim_end_matches(" bytes")), "B".to_owned()),
        Scale::AsMeasured => match logged {
            Some(unit) => plain(format!("{what}, {unit}"), unit.to_owned()),
            None => plain(format!("{what}, as logged"), String::new()),
        },
    }
}

/// Returns a column's name for people: `Upload throughput`.
pub(super) fn heading(column: &str) -> String {
    let words = column.replace(['-', '_'], " ");
    let mut chars = words.chars();
    chars.next().map_or_else(String::new, |first| first.to_uppercase().chain(chars).collect())
}

/// Returns the note on the number of values that are shown and the number left out: `n = 10,000 · left out: 5 warm-up, 3 without an
/// answer`.
pub(super) fn count_note<'a>(rows: &(impl Iterator<Item = RowRef<'a>> + Clone), shown: usize) -> String {
    let n = format!("n = {}", fixed(shown as f64, 0));
    excluded_and_undrawn_note(rows, shown).map_or(n.clone(), |left| format!("{n} · {left}"))
}

/// Returns the second half of [`count_note`], for figures whose counts are shown elsewhere; `None` if nothing is left out.
pub(super) fn excluded_and_undrawn_note<'a>(
    rows: &(impl Iterator<Item = RowRef<'a>> + Clone),
    shown: usize,
) -> Option<String> {
    let counted = rows.clone().filter(|row| row.is_counted()).count();
    let undrawn = (counted.saturating_sub(shown), "without a value to draw");
    join_counts(excluded_rows(rows).into_iter().chain([undrawn]))
}

/// Returns the note on the rows that no figure shows: `left out: 5 warm-up, 3 without an answer`; `None` if there are none.
pub(super) fn excluded_note<'a>(rows: &(impl Iterator<Item = RowRef<'a>> + Clone)) -> Option<String> {
    join_counts(excluded_rows(rows))
}

fn excluded_rows<'a>(rows: &(impl Iterator<Item = RowRef<'a>> + Clone)) -> [(usize, &'static str); 2] {
    let count = |of: &dyn Fn(&RowRef<'_>) -> bool| rows.clone().filter(|row| of(row)).count();
    [
        (count(&|row| row.warm_up()), "warm-up"),
        (count(&|row| !row.warm_up() && !row.is_counted()), "without an answer"),
    ]
}

fn join_counts(left: impl IntoIterator<Item = (usize, &'static str)>) -> Option<String> {
    let left: Vec<String> = left
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{} {what}", fixed(count as f64, 0)))
        .collect();
    (!left.is_empty()).then(|| format!("left out: {}", left.join(", ")))
}

/// Returns a title followed by the name of its run.
pub(super) fn with_run_name(what: &str, whose: &str) -> String {
    if whose.is_empty() { what.to_owned() } else { format!("{what} · {whose}") }
}
