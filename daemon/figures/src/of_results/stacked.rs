//! Sums of the stages of each configuration.

use peernet_logger::stage;
use peernet_statistics::Moments;
use peernet_statistics::number::{self, fixed};

use super::columns::{count_note, is_drawable, too_large_note};
use super::configured::{Configured, counted_rows};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::{Bar, Stacked, Unit};
use crate::look::UNATTRIBUTED;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::{LATENESS, RowRef};

/// Maximum number of bars in one figure.
const MAX_BARS: usize = 100;

/// Returns one bar for each configuration; repeats are merged.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let Configured { axes, groups: lines } = Configured::from_runs(runs);
    let all = || lines.iter().flat_map(|(_, runs)| counted_rows(runs));
    if all().next().is_none() {
        return Err(MissingData::Iterations);
    }
    // If one configuration has no measured total, all bars are the sums of their stages.
    let total = if all().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    // Lateness is the measured part of the time outside of stages; the rest follows it.
    let beyond: &[&str] = if total == "total" { &[LATENESS, UNATTRIBUTED] } else { &[] };
    let order = stage::ORDER;
    let candidates = order.iter().map(peernet_logger::Name::as_str).chain(beyond.iter().copied());
    let stages: Vec<String> = candidates
        .filter(|stage| all().any(|row| row.value(stage).is_some_and(is_drawable)))
        .map(str::to_owned)
        .collect();
    let mut bars: Vec<Bar> =
        lines.iter().filter_map(|(label, runs)| bar(label, runs, &stages, total)).collect();
    let (lines_of, without) = (bars.len(), lines.len() - bars.len());
    bars.truncate(MAX_BARS);
    let mut notes = vec![format!(
        "configurations: {} · parts: means · whisker and figures: mean ± standard deviation of the {}",
        axes.join(", "),
        if total == "total" { "measured total" } else { "sum of stages" }
    )];
    let mut missing = Vec::new();
    let rows = runs.iter().flat_map(|run| &run.rows);
    let counts = lines.iter().map(|(_, runs)| counted_rows(runs).count()).filter(|count| *count > 0);
    notes.push(with_each(&count_note(&rows, all().count()), &counts.collect::<Vec<_>>()));
    let columns: Vec<&str> =
        order.iter().map(peernet_logger::Name::as_str).chain(beyond.iter().copied()).chain([total]).collect();
    notes.extend(too_large_note(all(), &columns));
    if stages.iter().any(|stage| *stage == LATENESS) {
        notes.push("lateness: from the ordered start to the real one · unattributed: without it".to_owned());
    }
    if without > 0 {
        let configurations = number::counted(without as u64, "configuration");
        missing.push(format!("left out: {configurations} without an iteration that counts"));
    }
    notes.extend(unknown(&all));
    if lines_of > MAX_BARS {
        missing.push(format!("the first {MAX_BARS} of {} configurations", fixed(lines_of as f64, 0)));
    }
    notes.extend(missing.iter().cloned());
    let stacked = Stacked {
        title: "Latency by configuration".to_owned(),
        unit: Unit::milliseconds("Latency"),
        stages,
        bars,
        notes,
    };
    Ok(vec![Drawing::new("stacked", Shown::Stacked(stacked)).without(missing)])
}

/// Returns the account with the number of iterations behind each bar: `n = 88 (44 each)`, `n = 120 (10 to 110 each)`.
fn with_each(count_note: &str, counts: &[usize]) -> String {
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

/// Returns whether the delay of a message that was sent, or a value that depends on it, is not known: no measurement, and not 0 either.
fn is_unknown(row: RowRef<'_>, stage: &str) -> bool {
    let [up, down] = row.verdicts();
    let measured = match stage {
        "upload" => up.is_some(),
        "download" => down.is_some(),
        _ => stage == UNATTRIBUTED,
    };
    measured && row.value(stage).is_none()
}

/// Returns a note on the number of unknown delays.
fn unknown<'a, I: Iterator<Item = RowRef<'a>>>(all: &impl Fn() -> I) -> Option<String> {
    let of = |stage: &str| {
        let count = all().filter(|row| is_unknown(*row, stage)).count();
        (count > 0).then(|| format!("{} of {stage}", fixed(count as f64, 0)))
    };
    let told: Vec<String> = ["upload", "download"].into_iter().filter_map(of).collect();
    (!told.is_empty()).then(|| format!("left out of the means: unknown delays, {}", told.join(", ")))
}

/// Returns the length of a part of the bar.
fn length(row: RowRef<'_>, part: &str) -> Option<f64> {
    let late = if part == UNATTRIBUTED { row.value(LATENESS).unwrap_or_default() } else { 0.0 };
    Some(row.value(part)? - late)
}

/// Returns the bar; `None` for a configuration without an iteration that counts.
fn bar(label: &str, runs: &[&Loaded], stages: &[String], total: &str) -> Option<Bar> {
    let mut parts = vec![Moments::default(); stages.len()];
    let mut totals = Moments::default();
    let mut count = 0_u64;
    for row in counted_rows(runs) {
        count += 1;
        for (part, stage) in parts.iter_mut().zip(stages) {
            if !is_unknown(row, stage) {
                // A stage that did not occur took no time.
                part.record(length(row, stage).filter(|value| is_drawable(*value)).unwrap_or_default());
            }
        }
        if let Some(value) = row.value(total).filter(|value| is_drawable(*value)) {
            totals.record(value);
        }
    }
    let means: Vec<f64> = parts.into_iter().map(|part| part.mean).collect();
    let total = if totals.count > 0 { totals.mean } else { means.iter().sum() };
    (count > 0).then(|| Bar { label: label.to_owned(), means, total, std: totals.std() })
}
