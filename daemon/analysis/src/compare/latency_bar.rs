//! Mean latency of a configuration as a bar of its parts.

use peernet_logger::{Name, stage};
use peernet_statistics::Moments;

use super::Latency;
use crate::rows::{LATENESS, RowRef, is_plausible};
use crate::slowness::REST_OF_UNATTRIBUTED;
use crate::stage_split::{StageSplit, sent_in_rows};
use crate::total_column::TotalColumn;

/// Mean latency of a configuration and its parts, seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatencyBar {
    /// Mean of each part per iteration, in the [order of all parts](crate::stage_split::part_order). The parts add up
    /// to the total, unless the clocks show a stage as longer than it was. The lateness is a separate part, and the
    /// unattributed time without it is [`REST_OF_UNATTRIBUTED`]. In [`StageSplit`], the lateness is a part of the
    /// unattributed time instead.
    pub parts: Vec<(Name, f64)>,
    /// Mean of the column by which configurations are compared. If the configuration has no values of this column, the
    /// sum of the parts.
    pub total: f64,
    /// Sample standard deviation of the total; `None` below two values.
    pub std: Option<f64>,
}

impl LatencyBar {
    /// Returns the bar of a configuration with this number of iterations in the statistics. `latency_of` returns the
    /// latency of a node; `None` if the node has no values. `sent` holds the number of iterations that sent a message
    /// to the other host, and the number of iterations that received a message from it. Returns `None` without an
    /// iteration.
    pub fn new(
        column: TotalColumn,
        iterations: u64,
        sent: [u64; 2],
        latency_of: impl Fn(&str) -> Option<Latency>,
    ) -> Option<Self> {
        (iterations > 0).then_some(())?;
        let total = latency_of(column.name());
        let sum_of_stages = || {
            let means =
                stage::ORDER.into_iter().filter_map(|name| latency_of(&name)).map(|latency| latency.mean);
            (iterations, means.sum())
        };
        let count_and_mean = |latency: Latency| (latency.count, latency.mean);
        let total_count_and_mean = total.map_or_else(sum_of_stages, count_and_mean);
        let split = StageSplit::new(sent, |name| match column {
            _ if stage::TOTAL == *name => Some(total_count_and_mean),
            // If runs are compared by the sum of their stages, no time is outside of the stages.
            TotalColumn::SumOfStages if stage::UNATTRIBUTED == *name => Some((iterations, 0.0)),
            _ => latency_of(name).map(count_and_mean),
        });
        let lateness = (Name::from_static(LATENESS), split.unattributed_lateness);
        let unattributed_name = if split.unattributed_lateness > 0.0 {
            Name::from_static(REST_OF_UNATTRIBUTED)
        } else {
            stage::UNATTRIBUTED
        };
        let unattributed = (unattributed_name, split.unattributed_without_lateness());
        let outside_stages = [lateness, unattributed].into_iter().filter(|(_, seconds)| *seconds > 0.0);
        // Without a measured total, the time outside of the stages is not known.
        let outside_stages = outside_stages.filter(|_| column == TotalColumn::Measured && total.is_some());
        let stages = split.parts.into_iter().filter(|(name, _)| *name != stage::UNATTRIBUTED);
        let parts: Vec<(Name, f64)> = stages.chain(outside_stages).collect();
        let mean = total.map_or_else(|| parts.iter().map(|(_, mean)| mean).sum(), |total| total.mean);
        Some(Self { parts, total: mean, std: total.and_then(|total| total.std) })
    }

    /// Returns the bar of rows that are in the statistics, such as those of all repeats of a configuration. Numbers
    /// that are not [plausible](is_plausible) are left out. Returns `None` without a row.
    pub fn from_rows<'a>(
        column: TotalColumn,
        rows: &(impl Iterator<Item = RowRef<'a>> + Clone),
    ) -> Option<Self> {
        let latency_of = |name: &str| {
            let mut moments = Moments::default();
            let values = rows.clone().filter_map(|row| row.value(name));
            values.filter(|value| is_plausible(*value)).for_each(|value| moments.record(value));
            let Moments { count, mean, .. } = moments;
            (count > 0).then(|| Latency { mean, std: moments.std(), count })
        };
        Self::new(column, rows.clone().count() as u64, sent_in_rows(rows.clone()), latency_of)
    }

    /// Returns the mean of a part; `None` if the bar does not have it.
    pub fn part(&self, name: &str) -> Option<f64> {
        self.parts.iter().find(|(part, _)| part == name).map(|(_, mean)| *mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the parts of a bar of ten iterations, ms, and its total.
    fn bar(column: TotalColumn, sent: u64, nodes: &[(&str, f64)]) -> (Vec<(String, f64)>, f64) {
        let latency_of = |name: &str| {
            let node = nodes.iter().find(|(node, _)| *node == name);
            node.map(|(_, mean)| Latency { mean: mean / 1e3, std: None, count: 10 })
        };
        let bar = LatencyBar::new(column, 10, [sent; 2], latency_of).expect("has iterations");
        let milliseconds = |seconds: f64| (seconds * 1e6).round() / 1e3;
        let part = |(name, seconds): (Name, f64)| (name.to_string(), milliseconds(seconds));
        (bar.parts.into_iter().map(part).collect(), milliseconds(bar.total))
    }

    fn owned(parts: &[(&str, f64)]) -> Vec<(String, f64)> {
        parts.iter().map(|(name, mean)| ((*name).to_owned(), *mean)).collect()
    }

    #[test]
    fn lateness_is_separate_from_unattributed_time() {
        let nodes = [("total", 20.0), ("sensing", 12.0), ("lateness", 5.0)];
        let parts = [("sensing", 12.0), ("lateness", 5.0), (REST_OF_UNATTRIBUTED, 3.0)];
        assert_eq!(bar(TotalColumn::Measured, 0, &nodes), (owned(&parts), 20.0));
    }

    #[test]
    fn bar_and_split_agree_on_common_parts() {
        let nodes = [("total", 15.0), ("sensing", 10.0), ("lateness", 4.5)];
        let mean_of = |name: &str| nodes.iter().find(|(node, _)| *node == name).map(|(_, mean)| (10, *mean));
        let (parts, _) = bar(TotalColumn::Measured, 0, &nodes);
        let in_both: Vec<(String, f64)> = StageSplit::new([0; 2], mean_of)
            .parts
            .into_iter()
            .map(|(name, mean)| (name.to_string(), mean))
            .filter(|(name, _)| parts.iter().any(|(part, _)| part == name))
            .collect();
        assert!(in_both.iter().all(|part| parts.contains(part)), "{in_both:?} {parts:?}");
    }

    #[test]
    fn sum_of_stages_has_no_other_parts() {
        let nodes = [("stages-total", 9.0), ("sensing", 2.0), ("inference", 3.0), ("unattributed", 1.0)];
        let parts = [("sensing", 2.0), ("upload + download", 4.0), ("inference", 3.0)];
        assert_eq!(bar(TotalColumn::SumOfStages, 10, &nodes), (owned(&parts), 9.0));
        let nodes = [("sensing", 2.0), ("inference", 3.0)];
        assert_eq!(
            bar(TotalColumn::SumOfStages, 0, &nodes),
            (owned(&nodes), 5.0),
            "a bar without `stages-total` adds its parts"
        );
        assert_eq!(LatencyBar::new(TotalColumn::Measured, 0, [0; 2], |_| None), None);
    }
}
