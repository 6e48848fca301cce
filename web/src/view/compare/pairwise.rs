//! Distributions of pairwise differences: each iteration of a configuration minus each iteration of
//! the baseline, on one axis.

use peernet_analysis::compare::PairwiseDifference;
use peernet_figures::drawing::BinnedAxis;
use peernet_figures::look;
use peernet_figures::plot::Unit;
use peernet_statistics::Summary;
use peernet_statistics::number::{duration, percent};

use super::{Comparison, Differences};
use crate::picture::Picture;

/// Maximum number of distributions that are drawn.
const MAX_DISTRIBUTIONS: usize = 24;

/// Differences between the iterations of a configuration and those of the baseline.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PairwiseRow {
    /// Share of the pairs in which the configuration is faster than the baseline, percent.
    pub faster: String,
    pub picture: Picture,
}

/// Returns the pairwise differences between the totals of the baseline and of each other configuration, in the order of
/// `differences.others`. An entry is `None` if one of the two configurations has no total. The list has at most
/// [`MAX_DISTRIBUTIONS`] entries, and is empty if no axis can be drawn.
pub(crate) fn pairwise(comparison: &Comparison, differences: &Differences) -> Vec<Option<PairwiseRow>> {
    let all = &comparison.configurations;
    let total = |index: usize| all.get(index)?.summary(comparison.total_column.name());
    let pairwise_differences: Vec<Option<PairwiseDifference>> = differences
        .others
        .iter()
        .take(MAX_DISTRIBUTIONS)
        .map(|(index, _)| PairwiseDifference::between(total(differences.baseline)?, total(*index)?))
        .collect();
    // The axis must contain zero, because zero divides the pairs in which the configuration is faster (left) from the
    // others.
    let mut zero = Summary::default();
    zero.record(0.0);
    let distributions = pairwise_differences.iter().flatten().map(|pairwise| &pairwise.differences);
    let Some(axis) = BinnedAxis::around(distributions.chain([&zero]), Unit::symbol("ms", 1e3)) else {
        return Vec::new();
    };
    let row = |(pairwise, (index, _)): (Option<PairwiseDifference>, &(usize, _))| {
        let PairwiseDifference { differences: pairs, share_smaller } = pairwise?;
        let interval = differences.total(*index).and_then(|stage| stage.mean_difference?.interval);
        let faster = percent(share_smaller);
        let (below, above) = axis.beyond(&pairs);
        let beyond = match (below + above) as f64 / pairs.count().max(1) as f64 {
            0.0 => String::new(),
            beyond => format!(", {} % beyond the axis", percent(beyond)),
        };
        let median = pairs.quantile(0.5).map_or_else(String::new, |median| duration(median).to_string());
        let total_title = comparison.total_column.title().to_lowercase();
        let label = format!(
            "{total_title} of an iteration of {} minus {total_title} of an iteration of {}: median {median}, faster in \
             {faster} % of the pairs{beyond}",
            all[*index].name, all[differences.baseline].name,
        );
        let items = axis.histogram(&pairs, &look::stage(comparison.total_column.name()), interval);
        let picture =
            Picture::of_items(&items, "plot", &label).followed_by(&Picture::axis_below(&axis.scale));
        Some(PairwiseRow { faster, picture })
    };
    pairwise_differences.into_iter().zip(&differences.others).map(row).collect()
}
