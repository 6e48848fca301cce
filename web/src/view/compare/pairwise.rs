//! Distributions of the difference between an iteration and one of the baseline, on one axis.

use peernet_analysis::compare::PairwiseDifference;
use peernet_figures::drawing::BinnedAxis;
use peernet_figures::look;
use peernet_figures::plot::Unit;
use peernet_logger::stage;
use peernet_statistics::Summary;
use peernet_statistics::number::{duration, percent};

use super::{Comparison, Differences};
use crate::picture::Picture;

/// Largest number of distributions that are drawn.
const MOST: usize = 24;

/// Difference of a configuration from the baseline.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PairwiseRow {
    /// Share of the pairs in which it is faster, percent.
    pub faster: String,
    pub picture: Picture,
}

/// Returns the pairwise differences of the totals of each other configuration and the baseline, in the order of the differences; `None`
/// where one of both has no total, and beyond the room for pictures.
pub(crate) fn pairwise(comparison: &Comparison, differences: &Differences) -> Vec<Option<PairwiseRow>> {
    let all = &comparison.configurations;
    let total = |place: usize| all.get(place)?.known(&stage::TOTAL);
    let found: Vec<Option<PairwiseDifference>> = differences
        .others
        .iter()
        .take(MOST)
        .map(|(place, _)| PairwiseDifference::between(total(differences.baseline)?, total(*place)?))
        .collect();
    // The axis contains zero: values to its left are faster.
    let mut zero = Summary::default();
    zero.record(0.0);
    let known = found.iter().flatten().map(|found| &found.differences);
    let Some(axis) = BinnedAxis::around(known.chain([&zero]), Unit::symbol("ms", 1e3)) else {
        return Vec::new();
    };
    let row = |(found, (place, _)): (Option<PairwiseDifference>, &(usize, _))| {
        let PairwiseDifference { differences: pairs, share_smaller } = found?;
        let interval = differences.total(*place).and_then(|stage| stage.found?.interval);
        let faster = percent(share_smaller);
        let beyond = match axis.beyond(&pairs) as f64 / pairs.count().max(1) as f64 {
            0.0 => String::new(),
            beyond => format!(", {} % beyond the axis", percent(beyond)),
        };
        let median = pairs.quantile(0.5).map_or_else(String::new, |median| duration(median).to_string());
        let label = format!(
            "{} less {}, total of one iteration each: median {median}, faster in {faster} % of the pairs{beyond}",
            all[*place].name, all[differences.baseline].name
        );
        let items = axis.histogram(&pairs, &look::stage(&stage::TOTAL), interval);
        let picture =
            Picture::of_items(&items, "plot", &label).followed_by(&Picture::axis_below(&axis.scale));
        Some(PairwiseRow { faster, picture })
    };
    found.into_iter().zip(&differences.others).map(row).collect()
}
