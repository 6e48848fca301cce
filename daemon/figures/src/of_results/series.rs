//! Figure of the latencies of a run over time.

use super::columns::{is_drawable, too_large_note};
use super::longest_stages::LongestStages;
use super::missing_data::MissingData;
use super::replayed::title_with_marked_name;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Line, TimeSeries, Unit};
use peernet_analysis::outcomes::failed_in_warm_up;
use peernet_analysis::record::{Counts, RunRecord};
use peernet_analysis::rows::{Outcome, RowRef, Rows};
use peernet_analysis::total_column::TotalColumn;
use peernet_analysis::warm_up::warm_up_periods;
use peernet_statistics::number::count;

/// Title of the horizontal axis if the times of iterations are not known.
const ITERATION: &str = "Iteration";

/// Returns the figure of the total and the longest stages over time.
pub(super) fn drawings(record: &RunRecord, rows: &Rows) -> Result<Vec<Drawing>, MissingData> {
    let (x_title, time) = horizontal_axis(rows);
    // The rows include the warm-up, so that a reader sees how latency settles.
    let successful = || rows.iter().filter(|row| row.outcome() == Outcome::Ok);
    let line = |column: &str| {
        let values = successful().filter_map(|row| Some((time(row), row.value(column)?)));
        Line {
            name: column.to_owned(),
            values: values.filter(|(at, value)| is_drawable(*at) && is_drawable(*value)).collect(),
        }
    };
    let total_column = TotalColumn::from_rows(rows).name();
    let total = line(total_column);
    if total.values.is_empty() {
        return Err(MissingData::Total);
    }
    let has_total =
        |row: &RowRef<'_>| is_drawable(time(*row)) && row.value(total_column).is_some_and(is_drawable);
    let failed_rows = rows.iter().filter(|row| row.outcome() != Outcome::Ok);
    let failure_times = failed_rows.map(&time).filter(|at| is_drawable(*at)).collect();
    let stages = LongestStages::new(rows);
    let episode_start =
        |(previous, row): (RowRef<'_>, RowRef<'_>)| (previous.episode() != row.episode()).then(|| time(row));
    let time_series = TimeSeries {
        title: title_with_marked_name("Latency over time", record),
        x_is_iteration: x_title == ITERATION,
        x_title: x_title.to_owned(),
        unit: Unit::milliseconds("Latency"),
        notes: std::iter::once(count_and_warm_up_note(successful().filter(has_total)))
            .chain(too_large_note(rows.iter(), &[total_column]))
            .chain(stages.shorter_note())
            .collect(),
        total,
        stages: stages.longest.iter().map(|name| line(name)).collect(),
        warm_up: warm_up_periods(rows.iter().map(|row| (time(row), row.warm_up()))),
        episode_starts: rows.iter().zip(rows.iter().skip(1)).filter_map(episode_start).collect(),
        failure_times,
        failed_in_warm_up: failed_in_warm_up(rows),
    };
    Ok(vec![Drawing::new("series", AnyFigure::TimeSeries(time_series))])
}

/// Returns the note on the iterations that are shown, such as
/// `n = 54 and 5 warm-up · lines: medians`. The note has the number of iterations in the statistics
/// and the number of warm-up iterations, and says that each line joins the medians of short
/// intervals of time.
fn count_and_warm_up_note<'a>(shown: impl Iterator<Item = RowRef<'a>>) -> String {
    // The note does not mention iterations without a row, so their number is given as 0.
    let Counts { ok, warm_up, .. } = Counts::from_rows(shown, 0);
    let warm_up = if warm_up > 0 { format!(" and {} warm-up", count(warm_up)) } else { String::new() };
    format!("n = {}{warm_up} · lines: medians", count(ok))
}

/// Returns the title of the horizontal axis and a function that returns the position of a row on this axis. The
/// position is the time since the first iteration in seconds if all times are known, and the number of the iteration
/// otherwise.
fn horizontal_axis(rows: &Rows) -> (&'static str, impl Fn(RowRef<'_>) -> f64) {
    let has_times = !rows.is_empty() && rows.iter().all(|row| row.value("at").is_some());
    let start = rows.iter().map(|row| row.at()).fold(f64::INFINITY, f64::min);
    let title = if has_times { "Time since the start, s" } else { ITERATION };
    (title, move |row: RowRef<'_>| if has_times { row.at() - start } else { row.iteration() as f64 })
}
