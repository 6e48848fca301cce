//! Figure of the latencies of a run over time.

use super::columns::{count_note, is_drawable, too_large_note};
use super::longest_stages::LongestStages;
use super::missing_data::MissingData;
use super::replayed::title_with_marked_name;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Line, TimeSeries, Unit};
use peernet_analysis::record::RunRecord;
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
    let total = Some(line(TotalColumn::from_rows(rows).name())).filter(|line| !line.values.is_empty());
    let failed_rows = rows.iter().filter(|row| row.outcome() != Outcome::Ok);
    let failure_times = failed_rows.map(&time).filter(|at| is_drawable(*at)).collect();
    let Some(total) = total else {
        return Err(MissingData::Total);
    };
    let stages = LongestStages::new(rows);
    let episode_start =
        |(previous, row): (RowRef<'_>, RowRef<'_>)| (previous.episode() != row.episode()).then(|| time(row));
    let time_series = TimeSeries {
        title: title_with_marked_name("Latency over time", record),
        x_is_iteration: x_title == ITERATION,
        x_title: x_title.to_owned(),
        unit: Unit::milliseconds("Latency"),
        notes: std::iter::once(count_and_warm_up_note(rows, total.values.len()))
            .chain(too_large_note(rows.iter(), &[total.name.as_str()]))
            .chain(stages.shorter_note())
            .collect(),
        total,
        stages: stages.longest.iter().map(|name| line(name)).collect(),
        warm_up: warm_up_periods(rows.iter().map(|row| (time(row), row.warm_up()))),
        episode_starts: rows.iter().zip(rows.iter().skip(1)).filter_map(episode_start).collect(),
        failure_times,
    };
    Ok(vec![Drawing::new("series", AnyFigure::TimeSeries(time_series))])
}

/// Returns the note on the number of iterations in the statistics and on the number of iterations of the warm-up, which
/// this figure shows, too: `n = 54 and 5 warm-up · lines: medians`.
fn count_and_warm_up_note(rows: &Rows, shown_count: usize) -> String {
    let rows_in_statistics = rows.iter().filter(|row| row.is_in_statistics()).count();
    let note = count_note(&rows.iter(), rows_in_statistics);
    let n = note.split(" · ").next().unwrap_or_default();
    let warm_up_count = shown_count.saturating_sub(rows_in_statistics);
    let warm_up = if warm_up_count > 0 {
        format!(" and {} warm-up", count(warm_up_count as u64))
    } else {
        String::new()
    };
    format!("{n}{warm_up} · lines: medians")
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
