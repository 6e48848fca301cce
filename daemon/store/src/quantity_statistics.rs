//! Statistics of one quantity, without quantiles for which there are too few values.

use peernet_analysis::delays::{ClockInterval, CountedAverage, DelayAverages};
use peernet_analysis::slowness::Medians;
use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::Summary;
use serde::Serialize;
use utoipa::ToSchema;

/// Statistics of one quantity, in its SI unit. Quantiles are within 1 % of the true ones.
// The REST API sends this type as it is: these comments are its documentation. In the API, an absent number is null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
#[expect(missing_docs, reason = "the names of the other fields say what they are")]
// The REST API keeps the former name of this type.
#[schema(as = Figures)]
pub struct QuantityStatistics {
    /// Number of values.
    pub count: u64,
    pub mean: f64,
    /// Sample standard deviation; null below two values.
    pub std: Option<f64>,
    pub min: f64,
    pub p50: f64,
    /// Null below 60 values.
    pub p95: Option<f64>,
    /// Null below 300 values.
    pub p99: Option<f64>,
    pub max: f64,
}

impl QuantityStatistics {
    /// Returns the statistics of a summary; `None` if the summary has no values.
    pub fn from_summary(summary: &Summary) -> Option<Self> {
        let moments = &summary.moments;
        Some(Self {
            count: moments.count,
            mean: moments.mean,
            std: moments.std(),
            min: moments.min,
            p50: summary.quantile(0.5)?,
            p95: summary.p95(),
            p99: summary.p99(),
            max: moments.max,
        })
    }

    /// Returns the sum of the values.
    pub fn sum(&self) -> f64 {
        self.mean * self.count as f64
    }

    /// Returns the statistics of the lower ends and of the upper ends of intervals; `None` if there are no lower ends
    /// or no upper ends.
    pub fn from_ends([lower, upper]: &[Summary; 2]) -> Option<[Self; 2]> {
        Some([Self::from_summary(lower)?, Self::from_summary(upper)?])
    }
}

/// Returns the medians of a run's statistics.
pub(crate) fn medians(statistics: &[(Name, QuantityStatistics)]) -> Medians {
    Medians(statistics.iter().map(|(name, statistics)| (name.clone(), statistics.p50)).collect())
}

/// Accuracy of the delays of one direction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DelayAccuracy {
    /// `upload` or `download`.
    pub stage: Name,
    /// Half the width of the interval that contains the delay, seconds; `None` if no delay had an interval.
    pub half_width: Option<QuantityStatistics>,
    /// Lower and upper ends of the intervals of the delays whose value is known, seconds; `None` if an earlier version
    /// recorded the delays.
    pub ends: Option<[QuantityStatistics; 2]>,
    /// Number of delays per verdict, in the order of [`Verdict::ALL`]; verdicts without delays are omitted.
    pub verdicts: Vec<(Verdict, u64)>,
}

impl DelayAccuracy {
    /// Returns the number of messages from the edge to the cloud and the number of messages back. Messages whose delay
    /// is unknown are included.
    pub fn sent_messages(directions: &[Self]) -> [u64; 2] {
        [stage::UPLOAD, stage::DOWNLOAD].map(|name| {
            let direction = directions.iter().find(|direction| direction.stage == name);
            direction.map_or(0, |direction| direction.verdicts.iter().map(|(_, count)| count).sum())
        })
    }

    /// Returns the median of half the widths of the intervals, seconds; `None` when no delay had an interval.
    pub fn median_half_width(&self) -> Option<f64> {
        self.half_width.map(|width| width.p50)
    }

    /// Returns the interval that contains the median of the true delays; `delay` has the statistics of the estimated
    /// delays. `None` unless every delay has an interval.
    pub fn interval_of_median(&self, delay: &QuantityStatistics) -> Option<ClockInterval> {
        self.interval(delay, |statistics| statistics.p50)
    }

    /// Returns the interval that contains the mean of the true delays; `delay` has the statistics of the estimated
    /// delays. `None` unless every delay has an interval.
    pub fn interval_of_mean(&self, delay: &QuantityStatistics) -> Option<ClockInterval> {
        self.interval(delay, |statistics| statistics.mean)
    }

    fn interval(
        &self,
        delay: &QuantityStatistics,
        average: fn(&QuantityStatistics) -> f64,
    ) -> Option<ClockInterval> {
        let counted = |statistics: &QuantityStatistics| CountedAverage {
            count: statistics.count,
            value: average(statistics),
        };
        let averages = DelayAverages {
            delay: counted(delay),
            ends: self.ends.as_ref().map(|ends| ends.each_ref().map(counted)),
            half_width: self.half_width.as_ref().map(counted),
        };
        averages.interval()
    }
}

/// Children of `sensing`, in their order.
pub const SENSING_CHILDREN: [&str; 2] = ["capture", "transform"];

/// Returns the sort key of a name in tables: the stages in their order, then `total`, `stages-total`, `unattributed`,
/// throughputs, sizes, and custom names in alphabetical order.
pub fn table_order(name: &str) -> (usize, &str) {
    const NAMES_AFTER_STAGES: [Name; 9] = [
        stage::TOTAL,
        stage::STAGES_TOTAL,
        stage::UNATTRIBUTED,
        stage::UPLOAD_THROUGHPUT,
        stage::DOWNLOAD_THROUGHPUT,
        stage::UPLOAD_BYTES,
        stage::DOWNLOAD_BYTES,
        stage::UPLOAD_LOGGER_BYTES,
        stage::DOWNLOAD_LOGGER_BYTES,
    ];
    // `sensing` has position 0. Its children have positions between `sensing` and the next stage, as in a tree.
    let standard_position = || {
        let index = stage::ORDER.iter().chain(&NAMES_AFTER_STAGES).position(|standard| standard == name)?;
        Some((SENSING_CHILDREN.len() + 1) * index)
    };
    let sensing_child = SENSING_CHILDREN.iter().position(|child| *child == name).map(|index| index + 1);
    (sensing_child.or_else(standard_position).unwrap_or(usize::MAX), name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_is_absent_below_its_minimum_count() {
        let mut summary = Summary::default();
        assert_eq!(QuantityStatistics::from_summary(&summary), None);
        let statistics_at = |summary: &mut Summary, count: u64| {
            while summary.count() < count {
                summary.record(0.001);
            }
            QuantityStatistics::from_summary(summary).expect("has values")
        };
        let one = statistics_at(&mut summary, 1);
        assert_eq!((one.p50, one.std, one.p95), (0.001, None, None));
        assert_eq!(statistics_at(&mut summary, 59).p95, None);
        assert!(statistics_at(&mut summary, 60).p95.is_some());
        assert_eq!(statistics_at(&mut summary, 299).p99, None);
        assert!(statistics_at(&mut summary, 300).p99.is_some());
    }

    #[test]
    fn tables_show_stages_first_and_custom_names_last() {
        let mut names = ["zeta", "upload-bytes", "total", "upload", "capture", "alpha", "encode", "sensing"];
        names.sort_by_key(|name| table_order(name));
        assert_eq!(
            names,
            ["sensing", "capture", "encode", "upload", "total", "upload-bytes", "alpha", "zeta"]
        );
    }
}
