//! Sums of the stages of each configuration.

use peernet_logger::stage;
use peernet_statistics::Moments;
use peernet_statistics::number::{self, fixed};

use super::columns::{count_note, is_drawable, too_large_note};
use super::configuration_groups::{ConfigurationGroups, counted_rows};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Bar, Stacked, Unit};
use crate::look::UNATTRIBUTED;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::{LATENESS, RowRef};

/// Maximum number of bars in one figure.
const MAX_BARS: usize = 100;

/// Returns the figure with one bar for each configuration; repeats are pooled.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let all_rows = || groups.iter().flat_map(|(_, runs)| counted_rows(runs));
    if all_rows().next().is_none() {
        return Err(MissingData::Iterations);
    }
    // If one iteration has no measured total, all bars are the sums of their stages.
    let total = if all_rows().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    // The total also contains the time outside of stages: first the lateness, which is measured, then the rest.
    let outside_stages: &[&str] = if total == "total" { &[LATENESS, UNATTRIBUTED] } else { &[] };
    let order = stage::ORDER;
    let candidates = order.iter().map(peernet_logger::Name::as_str).chain(outside_stages.iter().copied());
    let stages: Vec<String> = candidates
        .filter(|stage| all_rows().any(|row| row.value(stage).is_some_and(is_drawable)))
        .map(str::to_owned)
        .collect();
    let mut bars: Vec<Bar> =
        groups.iter().filter_map(|(label, runs)| bar(label, runs, &stages, total)).collect();
    let (bar_count, omitted_groups) = (bars.len(), groups.len() - bars.len());
    bars.truncate(MAX_BARS);
    let mut notes = vec![format!(
        "configurations: {} · parts: means · whisker and numbers: mean ± standard deviation of the {}",
        axes.join(", "),
        if total == "total" { "measured total" } else { "sum of stages" }
    )];
    let mut missing = Vec::new();
    let rows = runs.iter().flat_map(|run| &run.rows);
    let counts = groups.iter().map(|(_, runs)| counted_rows(runs).count()).filter(|count| *count > 0);
    notes.push(with_count_per_bar(&count_note(&rows, all_rows().count()), &counts.collect::<Vec<_>>()));
    let stage_names = order.iter().map(peernet_logger::Name::as_str);
    let columns: Vec<&str> = stage_names.chain(outside_stages.iter().copied()).chain([total]).collect();
    notes.extend(too_large_note(all_rows(), &columns));
    if stages.iter().any(|stage| *stage == LATENESS) {
        notes.push(
            "late start: from the intended start to the actual start · unattributed: the rest of the total, without the late start".to_owned(),
        );
    }
    if omitted_groups > 0 {
        let configurations = number::counted(omitted_groups as u64, "configuration");
        missing.push(format!("left out: {configurations} without a counted iteration"));
    }
    notes.extend(unknown_delays_note(&all_rows));
    if bar_count > MAX_BARS {
        missing.push(format!("the first {MAX_BARS} of {} configurations", fixed(bar_count as f64, 0)));
    }
    notes.extend(missing.iter().cloned());
    let stacked = Stacked {
        title: "Latency by configuration".to_owned(),
        unit: Unit::milliseconds("Latency"),
        stages,
        bars,
        notes,
    };
    Ok(vec![Drawing::new("stacked", AnyFigure::Stacked(stacked)).with_left_out(missing)])
}

/// Returns the note on counts with the number of iterations of each bar: `n = 88 (44 each)`, `n = 120 (10 to 110 each)`.
fn with_count_per_bar(count_note: &str, counts: &[usize]) -> String {
    let (Some(fewest), Some(most), true) = (counts.iter().min(), counts.iter().max(), counts.len() > 1)
    else {
        return count_note.to_owned();
    };
    let number = |count: &usize| fixed(*count as f64, 0);
    let each = if fewest == most { number(most) } else { format!("{} to {}", number(fewest), number(most)) };
    let (n, rest) = count_note.split_once(" · ").map_or((count_note, None), |(n, rest)| (n, Some(rest)));
    let rest = rest.map_or_else(String::new, |rest| format!(" · {rest}"));
    format!("{n} ({each} each){rest}")
}

/// Returns whether the time of a stage is unknown: the delay of a message that was sent, or the unattributed time, which depends on the
/// delays. Such a time was not measured, but it is not 0 either.
fn is_unknown(row: RowRef<'_>, stage: &str) -> bool {
    let [up, down] = row.verdicts();
    let has_occurred = match stage {
        "upload" => up.is_some(),
        "download" => down.is_some(),
        _ => stage == UNATTRIBUTED,
    };
    has_occurred && row.value(stage).is_none()
}

/// Returns a note on the numbers of unknown delays; `None` if all delays are known.
fn unknown_delays_note<'a, I: Iterator<Item = RowRef<'a>>>(all_rows: &impl Fn() -> I) -> Option<String> {
    let count_of = |stage: &str| {
        let count = all_rows().filter(|row| is_unknown(*row, stage)).count();
        (count > 0).then(|| format!("{} of {stage}", fixed(count as f64, 0)))
    };
    let counts: Vec<String> = ["upload", "download"].into_iter().filter_map(count_of).collect();
    (!counts.is_empty()).then(|| format!("left out of the means: unknown delays, {}", counts.join(", ")))
}

/// Returns the length of a part of the bar. The part of the unattributed time is without the lateness, which has its own part.
fn part_length(row: RowRef<'_>, part: &str) -> Option<f64> {
    let lateness = if part == UNATTRIBUTED { row.value(LATENESS).unwrap_or_default() } else { 0.0 };
    Some(row.value(part)? - lateness)
}

/// Returns the bar of a configuration; `None` if the configuration has no counted iteration.
fn bar(label: &str, runs: &[&Loaded], stages: &[String], total: &str) -> Option<Bar> {
    let mut part_moments = vec![Moments::default(); stages.len()];
    let mut totals = Moments::default();
    let mut count = 0_u64;
    for row in counted_rows(runs) {
        count += 1;
        for (moments, stage) in part_moments.iter_mut().zip(stages) {
            if !is_unknown(row, stage) {
                // A stage that did not occur took no time.
                moments
                    .record(part_length(row, stage).filter(|value| is_drawable(*value)).unwrap_or_default());
            }
        }
        if let Some(value) = row.value(total).filter(|value| is_drawable(*value)) {
            totals.record(value);
        }
    }
    let means: Vec<f64> = part_moments.into_iter().map(|moments| moments.mean).collect();
    let total = if totals.count > 0 { totals.mean } else { means.iter().sum() };
    (count > 0).then(|| Bar { label: label.to_owned(), means, total, std: totals.std() })
}
