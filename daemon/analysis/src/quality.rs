//! Quality of the answers or of the episodes of a configuration.

use peernet_statistics::number::{fixed, share};
use peernet_statistics::{Moments, Summary};

use crate::accuracy::detection::DETECTION_SCORES;
use crate::accuracy::segmentation::SEGMENTATION_SCORE;
use crate::accuracy::{ACCURACIES, ACCURACY_TITLES, Accuracy, MeanScore, was_right};
use crate::actuator_results::{
    ActuatorResults, EPISODE_RETURN, EPISODE_SUCCESS, is_value_in_statistics, return_decimals,
};
use crate::rows::RowRef;

/// Quantity, other than latency, that says how good a configuration is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Share of the answers that are right.
    Top1,
    /// Mean average precision (mAP) at an overlap of 50 %, as the mean over the pictures.
    Map50,
    /// Mean intersection over union (mIoU) of a segmentation, as the mean over the pictures.
    MeanIou,
    /// Share of the episodes that were a success.
    Success,
    /// Mean of the returns of the episodes.
    Return,
}

/// Estimate of a quality: a share from 0 to 1, or a return.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QualityEstimate {
    /// The estimate.
    pub value: f64,
    /// 95 % confidence interval. For the mean of a single value, both ends are the estimate itself.
    pub interval: (f64, f64),
    /// Number of scored iterations or of episodes.
    pub count: u64,
    /// Sample standard deviation of the values; `None` for a single value and for shares.
    pub std: Option<f64>,
}

impl QualityEstimate {
    /// Returns the confidence interval. `None` for the mean of a single value, which has no interval. A share has an
    /// interval even if there is only one iteration or episode.
    pub fn known_interval(&self) -> Option<(f64, f64)> {
        Some(self.interval).filter(|(low, high)| self.count > 1 || low < high)
    }

    /// Formats the estimate, or an end of its interval: a share in percent, or a return with the decimals of
    /// [`EpisodeReturn::text`](crate::actuator_results::EpisodeReturn::text).
    pub fn format(&self, quality: Quality, value: f64) -> String {
        match quality {
            Quality::Return => fixed(value, return_decimals(self.value, self.std)),
            _ => share(value),
        }
    }
}

/// Count, mean and sample standard deviation of the values of a node.
pub type CountMeanStd = (u64, f64, Option<f64>);

impl Quality {
    /// All qualities.
    pub const ALL: [Self; 5] = [Self::Top1, Self::Map50, Self::MeanIou, Self::Success, Self::Return];

    /// Returns the name of the node, and of the column, with the values.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Top1 => ACCURACIES[0],
            Self::Map50 => DETECTION_SCORES[0],
            Self::MeanIou => SEGMENTATION_SCORE,
            Self::Success => EPISODE_SUCCESS,
            Self::Return => EPISODE_RETURN,
        }
    }

    /// Returns the common beginning of the names of the files of its figure.
    pub const fn figure_stem(self) -> &'static str {
        match self {
            Self::Top1 => "accuracy",
            Self::Success => "success",
            Self::Return => "return",
            Self::Map50 | Self::MeanIou => self.name(),
        }
    }

    /// Returns the title of a column with the estimates, and their unit: shares are shown in percent.
    pub const fn title(self) -> (&'static str, &'static str) {
        match self {
            Self::Top1 => (ACCURACY_TITLES[0], "%"),
            Self::Map50 => ("mAP@0.5", "%"),
            Self::MeanIou => ("mean IoU", "%"),
            Self::Success => ("success", "%"),
            Self::Return => ("return", ""),
        }
    }

    /// Returns whether the values belong to episodes and not to iterations.
    pub const fn is_of_episodes(self) -> bool {
        matches!(self, Self::Success | Self::Return)
    }

    /// Returns the estimate for a configuration; `None` without values. `statistics_of` returns the statistics of the
    /// node with this name, over all runs of the configuration. Counts, means and standard deviations are exact in
    /// roll-ups.
    pub fn from_statistics(
        self,
        statistics_of: impl Fn(&str) -> Option<CountMeanStd>,
    ) -> Option<QualityEstimate> {
        let mean_estimate = |(count, mean, std): CountMeanStd, range: (f64, f64)| {
            let MeanScore { mean, interval, count } = MeanScore::from_statistics(count, mean, std, range)?;
            Some(QualityEstimate { value: mean, interval: interval.unwrap_or((mean, mean)), count, std })
        };
        match self {
            Self::Top1 => {
                let (count, mean, _) = statistics_of(self.name())?;
                // Unscored answers are not reported here, so the number of answers is the number of scores.
                let Accuracy { share, interval, count, .. } = Accuracy::from_mean(mean, count, count)?;
                Some(QualityEstimate { value: share, interval, count, std: None })
            }
            // For a detection, the node `mean-iou` holds the mean overlap of the found objects, which is not a score of
            // the answer.
            Self::MeanIou if statistics_of(Self::Map50.name()).is_some() => None,
            Self::Map50 | Self::MeanIou => mean_estimate(statistics_of(self.name())?, (0.0, 1.0)),
            Self::Success => {
                let success = ActuatorResults::from_statistics(statistics_of).success?;
                Some(QualityEstimate {
                    value: success.rate,
                    interval: success.interval,
                    count: success.episodes,
                    std: None,
                })
            }
            Self::Return => mean_estimate(statistics_of(self.name())?, (f64::NEG_INFINITY, f64::INFINITY)),
        }
    }

    /// Returns the estimate from the rows of all runs of a configuration; `None` without values. Values outside the
    /// range of the quality are left out. `rows` is called once for each node that is needed.
    pub fn from_rows<'a, I: Iterator<Item = RowRef<'a>>>(
        self,
        rows: impl Fn() -> I,
    ) -> Option<QualityEstimate> {
        self.from_statistics(|name| {
            let moments: Moments = rows().filter_map(|row| value(row, name)).collect();
            (moments.count > 0).then(|| (moments.count, moments.mean, moments.std()))
        })
    }
}

/// Returns the value of a node in an iteration; `None` if the value is missing or invalid. An iteration that is not
/// in the statistics has only the values of its episode.
fn value(row: RowRef<'_>, name: &str) -> Option<f64> {
    match name {
        _ if !is_value_in_statistics(name, row.is_in_statistics()) => None,
        EPISODE_SUCCESS | EPISODE_RETURN => row.value(name).filter(|value| Summary::accepts(*value)),
        _ if ACCURACIES.contains(&name) => was_right(row, name).map(|is_right| f64::from(u8::from(is_right))),
        _ => row.value(name).filter(|score| (0.0..=1.0).contains(score)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Rows};
    use crate::testing::row_of_values;

    fn rows(outcome: Outcome, values: &[&[(&'static str, f64)]]) -> Rows {
        values.iter().map(|values| row_of_values(outcome, values)).collect()
    }

    fn value_and_count(quality: Quality, rows: &Rows) -> Option<(f64, u64)> {
        quality.from_rows(|| rows.iter()).map(|estimate| (estimate.value, estimate.count))
    }

    #[test]
    fn qualities_are_estimated_from_valid_values() {
        let scores = rows(Outcome::Ok, &[&[("top-1", 1.0)], &[("top-1", 0.0)], &[("top-1", 0.5)], &[]]);
        assert_eq!(value_and_count(Quality::Top1, &scores), Some((0.5, 2)));
        let masks = rows(Outcome::Ok, &[&[("mean-iou", 0.25)], &[("mean-iou", 0.75)], &[("mean-iou", 7.0)]]);
        assert_eq!(value_and_count(Quality::MeanIou, &masks), Some((0.5, 2)));
        let boxes = rows(Outcome::Ok, &[&[("mean-iou", 0.25), ("map-50", 0.5)]]);
        assert_eq!(value_and_count(Quality::MeanIou, &boxes), None, "the boxes are a detection");
        assert_eq!(value_and_count(Quality::Map50, &boxes), Some((0.5, 1)));
        let lost =
            rows(Outcome::Lost, &[&[("episode-success", 1.0), ("episode-return", -7.5), ("top-1", 1.0)]]);
        let values =
            [Quality::Success, Quality::Return, Quality::Top1].map(|one| value_and_count(one, &lost));
        assert_eq!(values, [Some((1.0, 1)), Some((-7.5, 1)), None], "an episode may end without an answer");
    }

    #[test]
    fn return_has_same_decimals_as_text_with_deviation() {
        let returns = (4, 123.456, Some(34.21));
        let estimate = Quality::Return.from_statistics(|_| Some(returns)).expect("four episodes");
        let text =
            ActuatorResults::from_statistics(|_| Some(returns)).episode_return.expect("a return").text();
        assert_eq!(text, "123.5 ± 34.2");
        assert_eq!(estimate.format(Quality::Return, estimate.value), "123.5");
    }

    #[test]
    fn single_value_has_no_interval_but_single_share_has_one() {
        let one = |quality: Quality| {
            let of_node = |name: &str| (name == quality.name()).then_some((1, 1.0, None));
            quality.from_statistics(of_node).expect("one value").known_interval().is_some()
        };
        assert_eq!(Quality::ALL.map(one), [true, false, false, true, false]);
    }
}
