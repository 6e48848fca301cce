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
    if drawings.is_empty() {
        return Err(MissingData::Labels { unknown: unknown_labels(runs) });
    }
    Ok(drawings)
}

/// Returns the common beginning of the names of a figure's files.
const fn stem(quality: Quality) -> &'static str {
    match quality {
        Quality::Top1 => "accuracy",
        Quality::Success => "success",
        Quality::Return => "return",
        Quality::Map50 | Quality::MeanIou => quality.name(),
    }
}

/// Returns the figure with one point for each configuration that has the quality; `None` if no configuration has the
/// quality. Repeats of a configuration are pooled.
fn drawing(runs: &[Loaded], quality: Quality) -> Option<Drawing> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let total = TotalColumn::from_rows(runs.iter().flat_map(|run| &run.rows));
    let point = |(label, runs): &(String, Vec<&Loaded>)| {
        let estimate = quality.from_rows(|| runs.iter().flat_map(|run| &run.rows))?;
        let times = values(runs.iter().flat_map(|run| &run.rows), total.name());
        let point =
            QualityPoint { label: label.clone(), estimate, median: times.median()?, p95: times.p95() };
        Some((point, unscored_count(runs, estimate.count)))
    };
    let scored: Vec<(QualityPoint, u64)> = groups.iter().filter_map(point).collect();
    let (point_count, omitted_groups) = (scored.len(), groups.len() - scored.len());
    let (points, unscored_counts): (Vec<QualityPoint>, Vec<u64>) =
        scored.into_iter().take(MAX_QUALITY_POINTS).unzip();
    let n = number::range_of_counts(points.iter().map(|point| point.estimate.count))?;
    let count_name = if quality.is_of_episodes() { "episodes:" } else { "n =" };
    let mut notes = vec![format!("configurations: {} · {count_name} {n} each", axes.join(", "))];
    let mut left_out = Vec::new();
    if point_count > MAX_QUALITY_POINTS {
        left_out.push(format!(
            "shown: the first {MAX_QUALITY_POINTS} of {} configurations",
            number::count(point_count as u64)
        ));
    }
    // The values of a quality of episodes are counted in episodes, so notes on numbers of iterations do not explain
    // them.
    if !quality.is_of_episodes() {
        notes.extend(excluded_note(&runs.iter().flat_map(|run| &run.rows)));
        if omitted_groups > 0 {
            let configurations = number::counted(omitted_groups as u64, "configuration");
            left_out.push(format!("left out: {configurations} without scored samples"));
        }
    }
    notes.extend(left_out.iter().cloned());
    notes.extend(too_large_note(runs.iter().flat_map(|run| &run.rows), &[total.name()]));
    if !quality.is_of_episodes() {
        notes.extend(unscored_notes(runs, unscored_counts.iter().sum()));
    }
    let figure =
        QualityAgainstLatency { quality, latency_unit: Unit::milliseconds(total.title()), points, notes };
    Some(Drawing::new(stem(quality), AnyFigure::QualityAgainstLatency(figure)).with_left_out(left_out))
}

/// Returns the number of iterations in the statistics without a valid score, from the number of scored iterations.
/// Iterations whose label the model does not know are not counted, because they have their own note.
fn unscored_count(runs: &[&Loaded], scored_count: u64) -> u64 {
    let unscored = (rows_in_statistics(runs).count() as u64).saturating_sub(scored_count);
    UnknownLabels::other_unscored(unknown_labels(runs.iter().copied()).as_ref(), unscored)
}

/// Returns notes on the iterations without a score. `unscored` is the sum of [`unscored_count`] over the configurations
/// in the figure.
fn unscored_notes(runs: &[Loaded], unscored: u64) -> Vec<String> {
    let unscored = (unscored > 0)
        .then(|| format!("not scored: {} without a valid score", number::counted(unscored, "iteration")));
    let unknown = unknown_labels(runs).map(|unknown| {
        format!("not scored: {}, {}", number::counted(unknown.count, "iteration"), unknown.reason())
    });
    unscored.into_iter().chain(unknown).collect()
}
