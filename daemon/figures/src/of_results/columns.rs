//! Values, units and notes that figures show for the columns of results.

use peernet_statistics::number::{count, counted};

use crate::drawing::Unit;
pub(super) use crate::drawing::is_drawable;
use peernet_analysis::order::SortedValues;
use peernet_analysis::outcomes::Counts;
use peernet_analysis::rows::{RowRef, Units};
use peernet_analysis::summary::Scale;

/// Returns a note on the count of numbers in these columns that are too large to be drawn; `None` if all can be drawn.
pub(super) fn too_large_note<'a>(rows: impl Iterator<Item = RowRef<'a>>, columns: &[&str]) -> Option<String> {
    let rows_in_statistics = rows.filter(|row| row.is_in_statistics());
    let numbers =
        rows_in_statistics.flat_map(|row| columns.iter().filter_map(move |column| row.value(column)));
    let undrawn = numbers.filter(|value| value.is_finite() && !is_drawable(*value)).count();
    // The font of figures has no superscript 8.
    (undrawn > 0).then(|| format!("not drawn, beyond ±1e18: {}", counted(undrawn as u64, "number")))
}

/// Returns the numbers of a column that can be drawn, from the rows in the statistics.
pub(super) fn values<'a>(rows: impl IntoIterator<Item = RowRef<'a>>, column: &str) -> SortedValues {
    let rows_in_statistics = rows.into_iter().filter(|row| row.is_in_statistics());
    let values = rows_in_statistics.filter_map(|row| row.value(column));
    values.filter(|value| is_drawable(*value)).collect()
}

/// Returns the unit in which the numbers of a column are shown, such as ms for a time. A quantity that custom code
/// logged has the unit that was logged with the quantity.
pub(super) fn unit(units: &Units, column: &str, quantity: &str) -> Unit {
    let unscaled = |title: String, symbol: String| Unit { title, symbol: symbol.into(), per_si: 1.0 };
    // These columns number the iterations, episodes and steps. They contain no measured quantities.
    if ["iteration", "episode", "step"].contains(&column) {
        return unscaled(quantity.to_owned(), String::new());
    }
    let logged_unit = units.of(column);
    match Scale::for_column(column, logged_unit) {
        Scale::Milliseconds => Unit::milliseconds(quantity),
        Scale::MegabytesPerSecond => Unit::megabytes_per_second(quantity),
        Scale::Bytes => unscaled(format!("{}, bytes", quantity.trim_end_matches(" bytes")), "B".to_owned()),
        Scale::AsMeasured => match logged_unit {
            Some(unit) => unscaled(format!("{quantity}, {unit}"), unit.to_owned()),
            None => unscaled(format!("{quantity}, as logged"), String::new()),
        },
    }
}

/// Returns the name of a column as a title: `Upload throughput`.
pub(super) fn heading(column: &str) -> String {
    let with_spaces = column.replace(['-', '_'], " ");
    let mut chars = with_spaces.chars();
    chars.next().map_or_else(String::new, |first| first.to_uppercase().chain(chars).collect())
}

/// Returns the note on the number of values that are shown and the numbers of rows that are left out: `n = 10,000 ·
/// left out: 5 warm-up, 3 failed`.
pub(super) fn count_note<'a>(
    rows: &(impl Iterator<Item = RowRef<'a>> + Clone),
    shown_count: usize,
) -> String {
    let n = format!("n = {}", count(shown_count as u64));
    undrawn_rows_note(rows, shown_count).map_or(n.clone(), |note| format!("{n} · {note}"))
}

/// Returns the note on the numbers of rows that are left out, with the rows that have no value to draw; `None` if
/// nothing is left out. It is the second half of [`count_note`], for figures that show the number of values elsewhere.
pub(super) fn undrawn_rows_note<'a>(
    rows: &(impl Iterator<Item = RowRef<'a>> + Clone),
    shown_count: usize,
) -> Option<String> {
    // The note does not mention iterations without a row, so their number is given as 0.
    left_out_note(&Counts::from_rows(rows.clone(), 0), shown_count as u64)
}

/// Returns the note on the numbers of rows that are not in the statistics: `left out: 5 warm-up, 3 failed`; `None` if
/// all rows are in the statistics.
pub(super) fn excluded_note<'a>(rows: &(impl Iterator<Item = RowRef<'a>> + Clone)) -> Option<String> {
    // The note does not mention iterations without a row, so their number is given as 0.
    let counts = Counts::from_rows(rows.clone(), 0);
    // All rows in the statistics count as shown, so that the note mentions only rows that are not
    // in the statistics.
    left_out_note(&counts, counts.ok)
}

/// Returns the note on the rows that are left out, each number with the reason. `shown_count` is the number of rows that
/// are shown. `None` if all rows are shown.
fn left_out_note(counts: &Counts, shown_count: u64) -> Option<String> {
    let undrawn = counts.ok.saturating_sub(shown_count);
    let numbers =
        [(counts.warm_up, "warm-up"), (counts.all_failed(), "failed"), (undrawn, "without a value to draw")];
    let texts: Vec<String> = numbers
        .into_iter()
        .filter(|(number, _)| *number > 0)
        .map(|(number, reason)| format!("{} {reason}", count(number)))
        .collect();
    (!texts.is_empty()).then(|| format!("left out: {}", texts.join(", ")))
}

/// Returns a title followed by the name of a run or link; the title alone if the name is empty.
pub(super) fn title_with_name(title: &str, name: &str) -> String {
    if name.is_empty() { title.to_owned() } else { format!("{title} · {name}") }
}
