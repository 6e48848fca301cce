//! Figures of the quality of each configuration against its latency. There is a figure for each quality, such as the
//! accuracy of answers or the success of episodes.

use peernet_statistics::number;

use super::columns::{excluded_note, too_large_note, values};
use super::configuration_groups::{ConfigurationGroups, rows_in_statistics};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{MAX_QUALITY_POINTS, QualityAgainstLatency, QualityPoint, Unit};
use peernet_analysis::accuracy::UnknownLabels;
use peernet_analysis::loaded::{Loaded, unknown_labels};
use peernet_analysis::quality::Quality;
use peernet_analysis::total_column::TotalColumn;

/// Returns the figures for which the runs have data: `accuracy`, `map-50` and `mean-iou` if the right answers are
/// known, and `success` and `return` if an actuator reports the success or the rewards of episodes.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let drawings: Vec<Drawing> =
        Quality::ALL.into_iter().filter_map(|quality| drawing(runs, quality)).collect();
    if !drawings.is_empty() {
        return Ok(drawings);
    }
    let has_values = |quality: Quality| quality.from_rows(|| runs.iter().flat_map(|run| &run.rows)).is_some();
    Err(if Quality::ALL.into_iter().any(has_values) {
        MissingData::Total
    } else {
        MissingData::Labels { unknown: unknown_labels(runs) }
    })
}

/// Returns the figure with one point for each configuration that has the quality and a latency; `None` if no
/// configuration has both. Repeats of a configuration are pooled.
fn drawing(runs: &[Loaded], quality: Quality) -> Option<Drawing> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let total = TotalColumn::from_rows(runs.iter().flat_map(|run| &run.rows));
    let mut points: Vec<QualityPoint> = Vec::new();
    let [mut beyond_maximum, mut without_quality, mut without_latency, mut unscored] = [0; 4];
    // The notes on iterations also cover the configurations without a quality or a latency, because a
    // note may give the reason, such as failed iterations. Configurations beyond the maximum are only
    // counted.
    let mut covered_runs: Vec<&Loaded> = Vec::new();
    for (label, runs) in &groups {
        let estimate = quality.from_rows(|| runs.iter().flat_map(|run| &run.rows));
        let times = values(runs.iter().flat_map(|run| &run.rows), total.name());
        match (estimate, times.median()) {
            (None, _) => without_quality += 1,
            (Some(_), None) => without_latency += 1,
            (Some(_), Some(_)) if points.len() == MAX_QUALITY_POINTS => {
                beyond_maximum += 1;
                continue;
            }
            (Some(estimate), Some(median)) => {
                unscored += unscored_count(runs, estimate.count);
                points.push(QualityPoint { label: label.clone(), estimate, median, p95: times.p95() });
            }
        }
        covered_runs.extend(runs);
    }
    let n = number::range_of_counts(points.iter().map(|point| point.estimate.count))?;
    let (count_name, scored_unit) =
        if quality.is_of_episodes() { ("episodes:", "episodes") } else { ("n =", "samples") };
    let mut notes = vec![format!("configurations: {} · {count_name} {n} each", axes.join(", "))];
    let mut left_out = Vec::new();
    if beyond_maximum > 0 {
        left_out.push(format!(
            "shown: the first {MAX_QUALITY_POINTS} of {} configurations",
            number::count(MAX_QUALITY_POINTS as u64 + beyond_maximum)
        ));
    }
    for (omitted_groups, missing) in [
        (without_quality, format!("scored {scored_unit}")),
        (without_latency, "a latency that can be drawn".to_owned()),
    ] {
        if omitted_groups > 0 {
            let configurations = number::counted(omitted_groups, "configuration");
            left_out.push(format!("left out: {configurations} without {missing}"));
        }
    }
    let covered_rows = || covered_runs.iter().flat_map(|run| &run.rows);
    // The values of a quality of episodes are counted in episodes, so notes on numbers of iterations do not explain
    // them.
    if !quality.is_of_episodes() {
        notes.extend(excluded_note(&covered_rows()));
    }
    notes.extend(left_out.iter().cloned());
    notes.extend(too_large_note(covered_rows(), &[total.name()]));
    if !quality.is_of_episodes() {
        notes.extend(unscored_notes(&covered_runs, unscored));
    }
    let figure =
        QualityAgainstLatency { quality, latency_unit: Unit::milliseconds(total.title()), points, notes };
    Some(
        Drawing::new(quality.figure_stem(), AnyFigure::QualityAgainstLatency(figure)).with_left_out(left_out),
    )
}

/// Returns the number of iterations in the statistics without a valid score, from the number of scored iterations.
/// Iterations whose label the model does not know are not counted, because they have their own note.
fn unscored_count(runs: &[&Loaded], scored_count: u64) -> u64 {
    let unscored = (rows_in_statistics(runs).count() as u64).saturating_sub(scored_count);
    UnknownLabels::other_unscored(unknown_labels(runs.iter().copied()).as_ref(), unscored)
}

/// Returns notes on the iterations without a score. `unscored` is the sum of [`unscored_count`] over the configurations
/// in the figure. Unknown labels are those of all `runs`.
fn unscored_notes(runs: &[&Loaded], unscored: u64) -> Vec<String> {
    let unscored = (unscored > 0)
        .then(|| format!("not scored: {} without a valid score", number::counted(unscored, "iteration")));
    let unknown = unknown_labels(runs.iter().copied()).map(|unknown| {
        format!("not scored: {}, {}", number::counted(unknown.count, "iteration"), unknown.reason())
    });
    unscored.into_iter().chain(unknown).collect()
}
