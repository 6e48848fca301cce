//! Statistics of whole runs.

use std::collections::HashMap;
use std::sync::Arc;

use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::stage_split::share_of_total;
use peernet_analysis::transfer::Transfers;
use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::{Merge, Summary};
use serde::Serialize;

use crate::quantity_statistics::{DelayAccuracy, QuantityStatistics, table_order};

/// Statistics of one node name over whole runs; successful iterations only, without the warm-up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageStatistics {
    /// The node's name.
    pub stage: Name,
    /// Unit of the values: `s`, `B`, `bit/s` or a custom unit.
    pub unit: String,
    /// `true` if the name is one of the stages that add up to `stages-total`.
    pub is_stage: bool,
    /// Statistics of the values.
    pub statistics: QuantityStatistics,
    /// Share of the nodes with this name in the mean of `total`, 0 to 1; `None` if the nodes measure no duration. An
    /// unknown delay counts as the mean of the known delays. The share of a child is also part of its parent's share.
    pub share: Option<f64>,
    /// Accuracy of one-way delays; `None` for other names.
    pub bound: Option<DelayAccuracy>,
}

/// Statistics of a whole run, or of several runs together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunStatistics {
    /// Statistics of each node name, in the order in which tables list the names: stages first.
    pub stages: Vec<StageStatistics>,
    /// Accuracy of the one-way delays: `upload`, `download`. A direction is present even if none of its delays has a
    /// value; `stages` then lacks the name.
    pub bounds: Vec<DelayAccuracy>,
    /// The mergeable statistics from which `stages` and `bounds` were made.
    // Shared, because `RunStatistics` is cloned, and sketches are large.
    pub mergeable: Arc<MergeableStatistics>,
}

impl RunStatistics {
    /// Returns the statistics of several runs together, as if they were one run: counts, means and deviations are
    /// exact, quantiles within 1 %.
    pub fn merged(runs: &[Self]) -> Self {
        if let [only] = runs {
            return only.clone();
        }
        let mut sum = MergeableStatistics::default();
        runs.iter().for_each(|run| sum.merge(&run.mergeable));
        Self::from(sum)
    }

    /// Returns how many bytes were sent, and how long they took.
    pub fn transfers(&self) -> Transfers {
        Transfers::from_statistics(|name| {
            let stage = self.stages.iter().find(|stage| stage.stage == *name)?;
            Some((stage.statistics.count, stage.statistics.mean))
        })
    }
}

impl From<MergeableStatistics> for RunStatistics {
    fn from(mergeable: MergeableStatistics) -> Self {
        Self { stages: mergeable.stages(), bounds: mergeable.bounds(), mergeable: Arc::new(mergeable) }
    }
}

/// Statistics of runs that can be merged: values, widths and ends of intervals, verdicts. Merged statistics are the
/// same as if all values had been added to one `MergeableStatistics`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergeableStatistics {
    values: HashMap<Name, NameSummary>,
    half_widths: HashMap<Name, Summary>,
    /// Lower ends and upper ends of the intervals.
    ends: HashMap<Name, [Summary; 2]>,
    verdicts: HashMap<Name, VerdictCounts>,
}

/// Values of one node name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct NameSummary {
    pub(crate) unit: String,
    pub(crate) summary: Summary,
}

impl NameSummary {
    pub(crate) fn with_unit(unit: &str) -> Self {
        Self { unit: unit.to_owned(), summary: Summary::default() }
    }

    pub(crate) fn statistics(&self) -> Option<QuantityStatistics> {
        QuantityStatistics::from_summary(&self.summary)
    }
}

impl MergeableStatistics {
    /// Returns the values of a node name in its SI unit; `None` if there are no values.
    pub fn summary(&self, name: &str) -> Option<&Summary> {
        self.values.get(name).map(|entry| &entry.summary)
    }

    /// Returns half the widths, in seconds, of the intervals of the delays of one direction; `None` if no delay has an
    /// interval.
    pub fn half_widths(&self, name: &str) -> Option<&Summary> {
        self.half_widths.get(name)
    }

    /// Returns the lower ends and the upper ends, in the SI unit, of the intervals of a delay or throughput. Infinite
    /// ends are left out. `None` if no value has an interval, or if an earlier version stored the values.
    pub fn ends(&self, name: &str) -> Option<&[Summary; 2]> {
        self.ends.get(name)
    }

    /// Adds values of a node name. If nodes with this name have several kinds of measure, the values of all kinds are
    /// merged.
    pub fn add(&mut self, name: Name, unit: &str, values: &Summary) {
        self.values.entry(name).or_insert_with(|| NameSummary::with_unit(unit)).summary.merge(values);
    }

    /// Adds half the widths, in seconds, of the intervals that contain the delays of one direction.
    pub fn add_half_widths(&mut self, stage: Name, widths: &Summary) {
        self.half_widths.entry(stage).or_default().merge(widths);
    }

    /// Adds lower ends and upper ends, in the SI unit, of the intervals of a delay or throughput.
    pub fn add_ends(&mut self, name: Name, [lower, upper]: [&Summary; 2]) {
        let ends = self.ends.entry(name).or_default();
        ends[0].merge(lower);
        ends[1].merge(upper);
    }

    /// Adds `count` delays of one direction with this verdict.
    pub fn add_verdicts(&mut self, stage: Name, verdict: Verdict, count: u64) {
        self.verdicts.entry(stage).or_default().add(verdict, count);
    }

    /// Adds all values of other statistics.
    pub fn merge(&mut self, other: &Self) {
        for (name, values) in &other.values {
            self.add(name.clone(), &values.unit, &values.summary);
        }
        for (stage, widths) in &other.half_widths {
            self.add_half_widths(stage.clone(), widths);
        }
        for (name, [lower, upper]) in &other.ends {
            self.add_ends(name.clone(), [lower, upper]);
        }
        for (stage, verdicts) in &other.verdicts {
            self.verdicts.entry(stage.clone()).or_default().merge(verdicts);
        }
    }

    fn stages(&self) -> Vec<StageStatistics> {
        // `share_of_total` counts an unknown delay as the mean of the known delays. It therefore needs the numbers of
        // sent messages.
        let sent_counts = DelayAccuracy::sent_messages(&self.bounds());
        let mean_of = |name: &str| {
            let moments = self.values.get(name)?.summary.moments;
            (moments.count > 0).then_some((moments.count, moments.mean))
        };
        let stages = self.values.iter().filter_map(|(stage, values)| {
            Some(StageStatistics {
                stage: stage.clone(),
                unit: values.unit.clone(),
                is_stage: stage::ORDER.contains(stage),
                statistics: values.statistics()?,
                share: share_of_total(stage, sent_counts, mean_of).filter(|_| values.unit == "s"),
                bound: self.bound(stage),
            })
        });
        let mut stages: Vec<StageStatistics> = stages.collect();
        stages.sort_by(|a, b| table_order(&a.stage).cmp(&table_order(&b.stage)));
        stages
    }

    fn bounds(&self) -> Vec<DelayAccuracy> {
        let without_verdicts = self.half_widths.keys().filter(|name| !self.verdicts.contains_key(*name));
        let mut bounds: Vec<DelayAccuracy> =
            self.verdicts.keys().chain(without_verdicts).filter_map(|name| self.bound(name)).collect();
        bounds.sort_by(|a, b| table_order(&a.stage).cmp(&table_order(&b.stage)));
        bounds
    }

    /// Returns the accuracy of a one-way delay, or `None` for other names.
    pub fn bound(&self, stage: &Name) -> Option<DelayAccuracy> {
        let (half_width, verdicts) = (self.half_widths.get(stage), self.verdicts.get(stage));
        (half_width.is_some() || verdicts.is_some()).then(|| DelayAccuracy {
            stage: stage.clone(),
            half_width: half_width.and_then(QuantityStatistics::from_summary),
            ends: self.ends.get(stage).and_then(QuantityStatistics::from_ends),
            verdicts: verdicts.copied().unwrap_or_default().counts().collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(values: impl Iterator<Item = f64>, verdict: Verdict) -> RunStatistics {
        let (mut mergeable, mut total) = (MergeableStatistics::default(), Summary::default());
        values.for_each(|value| total.record(value));
        // The delays of the uploads serve as half widths, too: of the half widths, the test checks only the number.
        let mut upload = Summary::default();
        (0..total.count()).for_each(|_| upload.record(0.002));
        mergeable.add(stage::TOTAL, "s", &total);
        mergeable.add(stage::UPLOAD, "s", &upload);
        mergeable.add_half_widths(stage::UPLOAD, &upload);
        mergeable.add_verdicts(stage::UPLOAD, verdict, total.count());
        RunStatistics::from(mergeable)
    }

    #[test]
    fn merged_runs_equal_one_run_of_all_values() {
        let all: Vec<f64> = (0..400).map(|n| 0.01 + f64::from(n % 13) * 1e-3).collect();
        let run_of = |values: &[f64], verdict| run(values.iter().copied(), verdict);
        let runs = [run_of(&all[..150], Verdict::Stale), run_of(&all[150..], Verdict::Ok)];
        let (one_run, merged_runs) = (run_of(&all, Verdict::Ok), RunStatistics::merged(&runs));
        let names: Vec<&Name> = merged_runs.stages.iter().map(|stage| &stage.stage).collect();
        assert_eq!(names, [&stage::UPLOAD, &stage::TOTAL]);
        let (single, merged) = (one_run.stages[1].statistics, merged_runs.stages[1].statistics);
        assert!((single.mean - merged.mean).abs() < 1e-12);
        assert!((single.std.expect("many values") - merged.std.expect("many values")).abs() < 1e-12);
        assert_eq!(
            (single.count, single.min, single.p50, single.p95, single.p99, single.max),
            (merged.count, merged.min, merged.p50, merged.p95, merged.p99, merged.max)
        );
        assert!(single.p99.is_some(), "400 values are enough for p99");
        let share = 400.0 * 0.002 / all.iter().sum::<f64>();
        assert!((merged_runs.stages[0].share.expect("a duration") - share).abs() < 1e-9);
        let bound = merged_runs.stages[0].bound.clone().expect("a delay");
        assert_eq!(
            bound.verdicts,
            [(Verdict::Ok, 250), (Verdict::Stale, 150)],
            "in the order of Verdict::ALL"
        );
        assert_eq!(bound.half_width.map(|width| width.count), Some(400));
        assert_eq!(merged_runs.bounds, [bound]);
    }

    #[test]
    fn merged_runs_have_quantile_if_values_suffice_together() {
        let short = run((0..40).map(|_| 0.01), Verdict::Ok);
        let total_of = |runs: &[RunStatistics]| RunStatistics::merged(runs).stages[1].statistics;
        assert_eq!(total_of(std::slice::from_ref(&short)).p95, None);
        assert!(total_of(&[short.clone(), short]).p95.is_some(), "the two runs have 80 values together");
        assert_eq!(RunStatistics::merged(&[]), RunStatistics::default());
    }
}
