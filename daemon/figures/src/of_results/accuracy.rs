//! Figures of the accuracy of answers, and of the success of episodes, of each configuration against its latency.

use peernet_statistics::number::{self, fixed};

use super::columns::{excluded_note, is_drawable, too_large_note};
use super::configuration_groups::{ConfigurationGroups, counted_rows};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Accuracy, Score, ScoredQuantity, Unit};
use peernet_analysis::accuracy::detection::DETECTION_SCORES;
use peernet_analysis::accuracy::segmentation::SEGMENTATION_SCORE;
use peernet_analysis::accuracy::{ACCURACIES, score};
use peernet_analysis::actuator_results::EPISODE_SUCCESS;
use peernet_analysis::loaded::{Loaded, unknown_labels};
use peernet_analysis::order::SortedValues;
use peernet_analysis::rows::RowRef;

/// Column that is 1 if the best class is the label, else 0.
pub(super) const TOP_1: &str = ACCURACIES[0];
/// Column with the mean average precision of a picture.
pub(super) const MAP_50: &str = DETECTION_SCORES[0];
/// Maximum number of points that a reader can distinguish.
const MAX_POINTS: usize = 24;

/// Scores of answers that a figure shows.
struct AnswerScore {
    /// Name of the figure's file.
    stem: &'static str,
    title: &'static str,
    quantity: ScoredQuantity,
    /// Column with the score.
    column: &'static str,
}

/// The scores of a classification, a detection and a segmentation.
const ANSWER_SCORES: [AnswerScore; 3] = [
    AnswerScore {
        stem: "accuracy",
        title: "Accuracy against latency",
        quantity: ScoredQuantity::Top1,
        column: TOP_1,
    },
    AnswerScore {
        stem: MAP_50,
        title: "Mean average precision against latency",
        quantity: ScoredQuantity::Map50,
        column: MAP_50,
    },
    AnswerScore {
        stem: SEGMENTATION_SCORE,
        title: "Mean IoU against latency",
        quantity: ScoredQuantity::MeanIou,
        column: SEGMENTATION_SCORE,
    },
];

impl AnswerScore {
    /// Returns the score of an iteration; `None` without a valid score.
    fn of(&self, row: RowRef<'_>) -> Option<f64> {
        match self.quantity {
            ScoredQuantity::Top1 => score(row, self.column).map(|is_right| f64::from(u8::from(is_right))),
            // For a detection, this column holds the mean overlap of the found objects, which is not a score of the answer.
            ScoredQuantity::MeanIou if row.value(MAP_50).is_some() => None,
            _ => row.value(self.column).filter(|score| (0.0..=1.0).contains(score)),
        }
    }

    fn estimate(&self, scores: &[f64]) -> Option<[f64; 3]> {
        if self.quantity == ScoredQuantity::Top1 {
            let right = scores.iter().filter(|score| **score == 1.0).count();
            return Score::estimate_of_counts(right as u64, scores.len() as u64);
        }
        Score::estimate_of_mean(scores)
    }
}

/// Returns the figures for which the runs have data: `accuracy`, `map-50` and `mean-iou`, where the right answers are known, and `success`,
/// where an actuator reports the success of episodes.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let drawings = ANSWER_SCORES.iter().filter_map(|scored| accuracy_drawing(runs, scored));
    let drawings: Vec<Drawing> = drawings.chain(success_drawing(runs)).collect();
    if drawings.is_empty() {
        return Err(MissingData::Labels { unknown: unknown_labels(runs) });
    }
    Ok(drawings)
}

/// Returns the figure with one point for each configuration with episodes; `None` without an episode. Repeats are pooled.
fn success_drawing(runs: &[Loaded]) -> Option<Drawing> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let group_score = |(label, runs): &(String, Vec<&Loaded>)| {
        let rows = || runs.iter().flat_map(|run| &run.rows);
        let successes: Vec<f64> = rows().filter_map(|row| row.value(EPISODE_SUCCESS)).collect();
        let totals = counted_rows(runs).filter_map(|row| row.value("total"));
        let times: SortedValues = totals.filter(|time| is_drawable(*time)).collect();
        Some(Score {
            label: label.clone(),
            estimate: Score::estimate_of_counts(
                successes.iter().filter(|success| **success == 1.0).count() as u64,
                successes.len() as u64,
            ),
            count: successes.len() as u64,
            median: times.median()?,
            p95: times.p95(),
        })
    };
    let mut scores: Vec<Score> =
        groups.iter().filter_map(group_score).filter(|score| score.count > 0).collect();
    let most = scores.iter().map(|score| score.count).max()?;
    let fewest = scores.iter().map(|score| score.count).min()?;
    let n = if fewest == most { fixed(most as f64, 0) } else { format!("{fewest} to {most}") };
    let missing = (scores.len() > MAX_POINTS)
        .then(|| format!("the first {MAX_POINTS} of {} configurations", scores.len()));
    scores.truncate(MAX_POINTS);
    let note = format!("configurations: {} · episodes: {n} each", axes.join(", "));
    let figure = Accuracy {
        title: "Success against latency".to_owned(),
        quantity: ScoredQuantity::Success,
        unit: Unit::milliseconds("Total"),
        scores,
        notes: std::iter::once(note).chain(missing.clone()).collect(),
    };
    let drawing = Drawing::new("success", AnyFigure::Accuracy(figure));
    Some(drawing.with_left_out(missing.into_iter().collect()))
}

/// Returns the figure with one point for each configuration that has scored answers; `None` without one. Repeats are pooled.
fn accuracy_drawing(runs: &[Loaded], scored: &AnswerScore) -> Option<Drawing> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let is_scored = |row: &RowRef<'_>| scored.of(*row).is_some();
    let all_rows = || groups.iter().flat_map(|(_, runs)| counted_rows(runs)).filter(is_scored);
    all_rows().next()?;
    let total = if all_rows().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    let group_score = |(label, runs): &(String, Vec<&Loaded>)| {
        let rows: Vec<RowRef<'_>> = counted_rows(runs).filter(is_scored).collect();
        let times: SortedValues =
            rows.iter().filter_map(|row| row.value(total)).filter(|time| is_drawable(*time)).collect();
        Some(Score {
            label: label.clone(),
            estimate: scored.estimate(&rows.iter().filter_map(|row| scored.of(*row)).collect::<Vec<_>>()),
            count: rows.len() as u64,
            median: times.median()?,
            p95: times.p95(),
        })
    };
    let mut scores: Vec<Score> = groups.iter().filter_map(group_score).collect();
    let (score_count, omitted_groups) = (scores.len(), groups.len() - scores.len());
    scores.truncate(MAX_POINTS);
    let fewest = scores.iter().map(|score| score.count).min().unwrap_or_default();
    let most = scores.iter().map(|score| score.count).max().unwrap_or_default();
    let number = |count: u64| fixed(count as f64, 0);
    let n = if fewest == most { number(most) } else { format!("{} to {}", number(fewest), number(most)) };
    let mut notes = vec![format!("configurations: {} · n = {n} each", axes.join(", "))];
    notes.extend(excluded_note(&runs.iter().flat_map(|run| &run.rows)));
    let mut missing = Vec::new();
    if score_count > MAX_POINTS {
        missing.push(format!("the first {MAX_POINTS} of {score_count} configurations"));
    }
    if omitted_groups > 0 {
        let configurations = number::counted(omitted_groups as u64, "configuration");
        missing.push(format!("left out: {configurations} without scored samples"));
    }
    notes.extend(missing.iter().cloned());
    // Iterations without a score, of configurations that are in the figure. Iterations whose label the model does not know are not counted
    // here, because they have their own note.
    let unscored_iterations = |(_, runs): &(String, Vec<&Loaded>)| {
        let scored_count = counted_rows(runs).filter(is_scored).count();
        let with_unknown_label = unknown_labels(runs.iter().copied()).map_or(0, |unknown| unknown.count);
        let without_score = (counted_rows(runs).count() - scored_count) as u64;
        if scored_count > 0 { without_score.saturating_sub(with_unknown_label) } else { 0 }
    };
    let unscored: u64 = groups.iter().map(unscored_iterations).sum();
    notes.extend(too_large_note(all_rows(), &[total]));
    if unscored > 0 {
        let iterations = number::counted(unscored, "iteration");
        notes.push(format!("left out: {iterations} without a valid score"));
    }
    if let Some(unknown) = unknown_labels(runs) {
        let iterations = number::counted(unknown.count, "iteration");
        notes.push(format!("left out: {iterations}, {}", unknown.reason()));
    }
    let quantity = if total == "total" { "Total" } else { "Sum of stages" };
    let accuracy = Accuracy {
        title: scored.title.to_owned(),
        quantity: scored.quantity,
        unit: Unit::milliseconds(quantity),
        scores,
        notes,
    };
    Some(Drawing::new(scored.stem, AnyFigure::Accuracy(accuracy)).with_left_out(missing))
}
