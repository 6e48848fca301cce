//! The numbers of one second of one pipeline, and their merge into windows.

use peernet_analysis::deadline::{DEADLINE_MISSED, Misses};
use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::outcomes::failed_share;
use peernet_analysis::stage_split::StageSplit;
use peernet_analysis::transfer::{DirectionNodes, Transfers, direction_of_delay};
use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::{Merge, Summary};
use peernet_stream::{OutcomeCounts, Second, bound_names};

use super::MAX_NAMES;
use crate::live_state::{LiveSecond, Window};
use peernet_store::{DelayAccuracy, QuantityStatistics, table_order};

/// Statistics of one or more seconds. A list is faster than a map here, because there are few names.
#[derive(Clone, Debug, Default)]
pub(super) struct SecondStatistics {
    counts: OutcomeCounts,
    /// Summaries by the name of the quantity: a node of the iteration's tree.
    values: Vec<(Name, Summary)>,
    /// Clock bounds of each direction: half widths under the name of the stage, lower and upper ends under its two
    /// [`bound_names`].
    bounds: Vec<(Name, Summary)>,
    /// Number of delays by verdict, in the order of [`Direction::ALL`](peernet_clock::Direction::ALL).
    verdicts: [VerdictCounts; 2],
}

impl SecondStatistics {
    /// Creates the numbers from an agent's report of a second, cut to `MAX_NAMES`. The number of removed names is
    /// added to `discarded_items`.
    pub(super) fn from_report(second: Second, discarded_items: &mut u64) -> Self {
        let Second { counts, mut values, mut bounds, verdicts: reported_verdicts, .. } = second;
        let mut limit = |names: &mut Vec<(Name, Summary)>| {
            *discarded_items += names.len().saturating_sub(MAX_NAMES) as u64;
            names.truncate(MAX_NAMES);
            names.shrink_to_fit();
        };
        limit(&mut values);
        limit(&mut bounds);
        let mut verdicts = [VerdictCounts::default(); 2];
        for (stage, verdict, count) in reported_verdicts {
            let direction = direction_of_delay(&stage);
            // Verdicts that only a later version knows are left out.
            if let (Some(direction), Some(verdict)) = (direction, Verdict::from_name(&verdict)) {
                verdicts[direction as usize].add(verdict, count);
            }
        }
        Self { counts, values, bounds, verdicts }
    }

    /// Returns the summary of the total latency; `None` if no iteration succeeded.
    pub(super) fn total(&self) -> Option<&Summary> {
        self.values.iter().find(|(name, _)| *name == stage::TOTAL).map(|(_, summary)| summary)
    }

    /// Returns the second in the form of the live charts.
    pub(super) fn to_live_second(&self, at: i64) -> LiveSecond {
        let mut means: Vec<(Name, f64)> = self
            .values
            .iter()
            .filter(|(_, summary)| summary.count() > 0)
            .map(|(name, summary)| (name.clone(), summary.moments.mean))
            .collect();
        // All lists of names have this order, whatever order the agent used.
        means.sort_by(|(a, _), (b, _)| table_order(a).cmp(&table_order(b)));
        let mean_of = |name: &str| {
            let (_, summary) = self.values.iter().find(|(other, _)| other == name)?;
            (summary.count() > 0).then_some((summary.count(), summary.moments.mean))
        };
        // Each message has a verdict, even if its delay is unknown. So the totals of the verdicts count the messages.
        let StageSplit { parts, .. } = StageSplit::new(self.verdicts.map(VerdictCounts::total), mean_of);
        let total_p95 =
            self.total().and_then(QuantityStatistics::from_summary).and_then(|statistics| statistics.p95);
        let (transfers, verdicts) = (self.transfers(), self.verdicts);
        LiveSecond { at, counts: self.counts, means, parts, total_p95, transfers, verdicts }
    }

    /// Returns the data rates of both directions.
    fn transfers(&self) -> Transfers {
        Transfers::from_statistics(|name| {
            let (_, summary) = self.values.iter().find(|(other, _)| other == name)?;
            Some((summary.count(), summary.moments.mean))
        })
    }

    /// Returns the numbers of a window of `seconds` complete seconds and the incomplete second. `covered_s` is the time
    /// that the data cover, including the incomplete second.
    pub(super) fn window(&self, seconds: u32, covered_s: f64) -> Window {
        let total = self.counts.total();
        let statistics = |(name, summary): &(Name, Summary)| {
            Some((name.clone(), QuantityStatistics::from_summary(summary)?))
        };
        let mut values: Vec<(Name, QuantityStatistics)> = self.values.iter().filter_map(statistics).collect();
        values.sort_by(|(a, _), (b, _)| table_order(a).cmp(&table_order(b)));
        // A pipeline with a deadline reports a value of `DEADLINE_MISSED` for each answer: 1 for a late answer and 0
        // for any other. The sum of these values is the number of late answers. In a second without any answer, the
        // name is reported without values: all iterations failed and missed the deadline.
        let deadline_missed = self.values.iter().find(|(name, _)| *name == *DEADLINE_MISSED);
        let late_answers = deadline_missed.map(|(_, summary)| summary.moments.sum().round() as u64);
        let misses = late_answers.map(|late| Misses::new(self.counts.ok, late, self.counts.all_failed()));
        Window {
            seconds,
            covered_s,
            counts: self.counts,
            rate_hz: total as f64 / covered_s,
            failed_fraction: failed_share(&self.counts),
            miss_rate: misses.and_then(Misses::rate),
            values,
            transfers: self.transfers(),
            bounds: self.delay_bounds(),
        }
    }

    /// Returns the clock bounds of both directions.
    fn delay_bounds(&self) -> Vec<DelayAccuracy> {
        DirectionNodes::both()
            .map(|nodes| nodes.delay.clone())
            .into_iter()
            .zip(self.verdicts)
            .filter_map(|(stage, verdicts)| {
                let statistics = |wanted: &Name| {
                    let (_, summary) = self.bounds.iter().find(|(name, _)| name == wanted)?;
                    QuantityStatistics::from_summary(summary)
                };
                let half_width = statistics(&stage);
                let ends =
                    bound_names(&stage).and_then(|[lo, hi]| Some([statistics(&lo)?, statistics(&hi)?]));
                (half_width.is_some() || !verdicts.is_empty()).then(|| DelayAccuracy {
                    stage,
                    half_width,
                    ends,
                    verdicts: verdicts.counts().collect(),
                })
            })
            .collect()
    }
}

impl Merge for SecondStatistics {
    fn merge(&mut self, other: &Self) {
        self.counts.merge(&other.counts);
        merge_named(&mut self.values, &other.values);
        merge_named(&mut self.bounds, &other.bounds);
        self.verdicts.iter_mut().zip(&other.verdicts).for_each(|(verdicts, other)| verdicts.merge(other));
    }
}

/// Merges summaries by name, up to `MAX_NAMES`.
fn merge_named(into: &mut Vec<(Name, Summary)>, from: &[(Name, Summary)]) {
    for (position, (name, summary)) in from.iter().enumerate() {
        // Fast path: most seconds list the same names in the same order.
        let index = match into.get(position) {
            Some((other, _)) if other == name => Some(position),
            _ => into.iter().position(|(other, _)| other == name),
        };
        match index {
            Some(index) => into[index].1.merge(summary),
            None if into.len() < MAX_NAMES => into.push((name.clone(), summary.clone())),
            None => {}
        }
    }
}
