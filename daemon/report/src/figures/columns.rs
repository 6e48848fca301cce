//! Columns of results as quantities of figures.

use crate::figure::Unit;
use crate::number::fixed;
use crate::order::Ordered;
use crate::results::{Row, Scale};

/// A column's finite numbers in the rows that count.
pub(super) fn values(rows: &[Row], column: &str) -> Ordered {
    let counted = rows.iter().filter(|row| row.counts());
    counted.filter_map(|row| row.value(column)).filter(|value| value.is_finite()).collect()
}

/// How a column's numbers are shown: a time is in ms, and so on. Of what a run logged itself the unit is not known.
pub(super) fn unit(column: &str, what: &str) -> Unit {
    let plain = |title: String, symbol| Unit { title, symbol, per_si: 1.0 };
    match Scale::of(column) {
        Scale::Milliseconds => Unit::milliseconds(what),
        Scale::MegabytesPerSecond => Unit::megabytes_per_second(what),
        Scale::Bytes => plain(format!("{}, bytes", what.trim_end_matches(" bytes")), "B"),
        Scale::AsMeasured => plain(format!("{what}, as logged"), ""),
    }
}

/// A column's name for people: `Upload throughput`.
pub(super) fn heading(column: &str) -> String {
    let words = column.replace(['-', '_'], " ");
    let mut chars = words.chars();
    chars.next().map_or_else(String::new, |first| first.to_uppercase().chain(chars).collect())
}

/// What stands in the rows, what is shown of it and what is left out: `n = 10,000 · left out: 5 warm-up, 3 without an
/// answer`.
pub(super) fn account<'a>(rows: &(impl Iterator<Item = &'a Row> + Clone), shown: usize) -> String {
    let count = |of: &dyn Fn(&Row) -> bool| rows.clone().filter(|row| of(row)).count();
    let counted = count(&Row::counts);
    let left = [
        (count(&|row| row.warm_up), "warm-up"),
        (count(&|row| !row.warm_up && !row.counts()), "without an answer"),
        (counted.saturating_sub(shown), "without a value"),
    ];
    let number = |count: usize| fixed(count as f64, 0);
    let left: Vec<String> = left
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{} {what}", number(count)))
        .collect();
    let shown = format!("n = {}", number(shown));
    if left.is_empty() { shown } else { format!("{shown} · left out: {}", left.join(", ")) }
}

/// A title and, behind it, whose it is.
pub(super) fn titled(what: &str, whose: &str) -> String {
    if whose.is_empty() { what.to_owned() } else { format!("{what} · {whose}") }
}
