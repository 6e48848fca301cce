//! Figure of a run over time.

use peernet_logger::{Name, stage};

use super::columns::{count_note, is_drawable, too_large_note, with_run_name};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::{Course, Line, Unit};
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{Outcome, RowRef, Rows};

/// Number of the longest stages that are shown beside the total.
const STAGE_CURVES: usize = 4;
/// Title of the horizontal axis if times are not known.
const ITERATION: &str = "Iteration";

/// Returns the figure of the total and the stages over time.
pub(super) fn drawings(record: &RunRecord, rows: &Rows) -> Result<Vec<Drawing>, MissingData> {
    let (x, time) = times(rows);
    let answered = || rows.iter().filter(|row| row.outcome() == Outcome::Ok);
    let line = |column: &str| {
        let values = answered().filter_map(|row| Some((time(row), row.value(column)?)));
        Line {
            name: column.to_owned(),
            values: values.filter(|(at, value)| is_drawable(*at) && is_drawable(*value)).collect(),
        }
    };
    let total = ["total", "stages-total"].map(line);
    let total = total.into_iter().find(|line| !line.values.is_empty());
    let unanswered = rows.iter().filter(|row| row.outcome() != Outcome::Ok).map(&time);
    let unanswered = unanswered.filter(|at| is_drawable(*at)).collect();
    let Some(total) = total else {
        return Err(MissingData::Total);
    };
    // The sums are computed before any line, because the lines of all stages of a long run would need much more memory.
    let sum =
        |name: &str| answered().filter_map(|row| row.value(name)).filter(|value| is_drawable(*value)).sum();
    let mut stages: Vec<(f64, usize, Name)> =
        stage::ORDER.into_iter().enumerate().map(|(place, name)| (sum(&name), place, name)).collect();
    stages.sort_by(|a, b| b.0.total_cmp(&a.0));
    let shorter = stages.split_off(STAGE_CURVES.min(stages.len()));
    stages.sort_by_key(|(_, place, _)| *place);
    let stages = stages.iter().map(|(_, _, name)| line(name));
    let first = |(last, row): (RowRef<'_>, RowRef<'_>)| (last.episode() != row.episode()).then(|| time(row));
    let course = Course {
        title: with_run_name("Latency over time", &record.title),
        is_counted: x == ITERATION,
        x: x.to_owned(),
        unit: Unit::milliseconds("Latency"),
        notes: std::iter::once(account_of(rows, total.values.len()))
            .chain(too_large_note(rows.iter(), &[total.name.as_str()]))
            .chain(not_drawn(shorter))
            .collect(),
        total,
        stages: stages.filter(|line| !line.values.is_empty()).collect(),
        warm_up: warm_up(rows, &time),
        episodes: rows.iter().zip(rows.iter().skip(1)).filter_map(first).collect(),
        unanswered,
    };
    Ok(vec![Drawing::new("series", Shown::Course(course))])
}

/// Returns a note on the stages that occurred and have no line.
fn not_drawn(mut shorter: Vec<(f64, usize, Name)>) -> Option<String> {
    shorter.retain(|(sum, ..)| *sum != 0.0);
    shorter.sort_by_key(|(_, place, _)| *place);
    let names: Vec<&str> = shorter.iter().map(|(_, _, name)| name.as_str()).collect();
    (!names.is_empty()).then(|| format!("shorter stages, not drawn: {}", names.join(", ")))
}

/// Returns the account without the warm-up, which is in the figure.
fn account_of(rows: &Rows, shown: usize) -> String {
    let counted = count_note(&rows.iter(), rows.iter().filter(|row| row.is_counted()).count());
    let counted = counted.split(" · ").next().unwrap_or_default().to_owned();
    let warm = shown.saturating_sub(rows.iter().filter(|row| row.is_counted()).count());
    let warm = if warm > 0 { format!(" and {warm} warm-up") } else { String::new() };
    format!("{counted}{warm} · lines: medians")
}

/// Returns the horizontal axis: seconds since the first iteration if all times are known, else the numbers of the iterations.
fn times(rows: &Rows) -> (&'static str, impl Fn(RowRef<'_>) -> f64) {
    let known = !rows.is_empty() && rows.iter().all(|row| row.value("at").is_some());
    let begun = rows.iter().map(|row| row.at()).fold(f64::INFINITY, f64::min);
    let title = if known { "Time since the start, s" } else { ITERATION };
    (title, move |row: RowRef<'_>| if known { row.at() - begun } else { row.iteration() as f64 })
}

/// Returns the periods of consecutive rows of warm-up.
fn warm_up(rows: &Rows, time: &impl Fn(RowRef<'_>) -> f64) -> Vec<(f64, f64)> {
    let mut ranges = Vec::new();
    let mut begun: Option<f64> = None;
    for row in rows {
        match (row.warm_up(), begun) {
            (true, None) => begun = Some(time(row)),
            (false, Some(from)) => {
                ranges.push((from, time(row)));
                begun = None;
            }
            _ => {}
        }
    }
    ranges.extend(begun.zip(rows.last().map(time)));
    ranges
}
