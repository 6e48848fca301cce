//! Test of whether a distribution has two modes.

use crate::Summary;

/// Minimum number of values for the test.
const MIN_VALUES: u64 = 100;
/// [Excess mass](excess_mass) that chance can cause in n values, multiplied by √n. If samples of 100 to 500 values are
/// drawn from a uniform distribution, fewer than 1 % of them have a larger excess mass. In simulations, the 99th
/// percentile of the excess mass times √n is 1.04 for 100 values, 1.11 for 300 values and 1.19 for 1,000 values. This
/// constant matters only up to 529 values: above, [`MIN_EXCESS`] is the higher limit.
const EXCESS_BY_CHANCE: f64 = 1.15;
/// Minimum excess mass: a twentieth of the values would have to be moved to remove the second mode.
const MIN_EXCESS: f64 = 0.05;
/// Minimum ratio of the upper mode to the lower mode. If the modes are closer together, mean and standard deviation
/// still describe the values.
const MIN_RATIO: f64 = 1.2;
/// Maximum distance by which a bin of the sketch is extended to each side, as a difference of natural logarithms. If
/// the middle between two whole numbers is farther away, that middle is the limit.
const MAX_REACH: f64 = 0.1;
/// Factor by which the bins of two neighbouring whole numbers may extend beyond the middle between the two, because the
/// sketch rounds values.
const WHOLE_NUMBER_MARGIN: f64 = 1.1;
/// Minimum length of a gap between two bins. A shorter gap is a rounding error.
const MIN_GAP: f64 = 1e-9;
/// Number of steps between the lowest and the highest density. The excess mass is computed at each step.
const LEVELS: i32 = 128;

/// Two groups of values: those around the lower mode and those around the upper mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoModes {
    /// Median of the lower and of the upper group.
    pub medians: (f64, f64),
    /// Share of all values that are in the upper group, 0 to 1.
    pub upper_share: f64,
}

/// Bin of the distribution on the logarithmic axis.
struct Bin {
    /// Value in the middle of the sketch's bin.
    value: f64,
    /// Length on the axis.
    length: f64,
    /// Share of the values.
    mass: f64,
}

impl Summary {
    /// Returns the two modes of the values above zero, if the values clearly have two modes. This is so if the excess
    /// mass of two modes over one (Müller and Sawitzki, *Excess mass estimates and tests for multimodality*, Journal of
    /// the American Statistical Association 86, 1991) is larger than chance explains (p < 0.01) and is at least a
    /// twentieth of the values.
    ///
    /// The excess mass is twice the dip of Hartigan and Hartigan (The Annals of Statistics 13, 1985). As in their test,
    /// chance means samples of a uniform distribution. Distributions with a peak, such as log-normal distributions,
    /// cause even fewer false alarms. The two groups are divided at the threshold of Otsu (IEEE Transactions on
    /// Systems, Man, and Cybernetics 9, 1979), on a logarithmic axis.
    ///
    /// `None` with fewer than 100 values above zero, with one mode, or if the upper mode is less than 20 % above the
    /// lower mode.
    pub fn two_modes(&self) -> Option<TwoModes> {
        let positive: Vec<(f64, u64)> = self.sketch.bins().filter(|(value, _)| *value > 0.0).collect();
        let count: u64 = positive.iter().map(|(_, count)| count).sum();
        (count >= MIN_VALUES && positive.len() >= 2).then_some(())?;
        let bins = bins(&positive, count);
        let excess = excess_mass(&bins);
        let two_modes = divide(&bins)?;
        let (lower, upper) = two_modes.medians;
        let is_clear = excess >= MIN_EXCESS.max(EXCESS_BY_CHANCE / (count as f64).sqrt());
        (is_clear && upper >= MIN_RATIO * lower).then_some(two_modes)
    }
}

/// Returns the distribution as bins, with empty bins for gaps. Each bin of the sketch extends halfway to its
/// neighbours, but at most by [`MAX_REACH`] or halfway to the next whole number, whichever is farther.
// Without the rule for whole numbers, there would be valleys between whole numbers, for example between numbers of
// tokens.
fn bins(positive: &[(f64, u64)], count: u64) -> Vec<Bin> {
    let logarithm = |index: usize| positive[index].0.ln();
    // The middle between two whole numbers needs a margin, because a sketch knows values within 1 % only.
    let reach = |ratio: f64| MAX_REACH.max(0.5 * WHOLE_NUMBER_MARGIN * ratio.ln());
    let mut bins = Vec::with_capacity(positive.len());
    let last_index = positive.len() - 1;
    // Distance by which the current bin extends to the left; the first bin has no neighbour there.
    let mut left = None;
    for (index, (value, values)) in positive.iter().enumerate() {
        let (distance, right, left_of_next) = if index < last_index {
            let (distance, next) = (logarithm(index + 1) - logarithm(index), positive[index + 1].0);
            let to_next = reach((value + 1.0) / value);
            // The whole number below 1 is 0, which has no logarithm.
            let from_next = if next > 1.0 { reach(next / (next - 1.0)) } else { f64::INFINITY };
            (distance, to_next.min(distance / 2.0), from_next.min(distance / 2.0))
        } else {
            // The last bin extends to the right as far as to the left. No gap follows, so the distance is not used.
            let left = left.unwrap_or(MAX_REACH);
            (left, left, 0.0)
        };
        // The first bin extends to the left as far as to the right.
        let length = left.unwrap_or(right) + right;
        bins.push(Bin { value: *value, length, mass: *values as f64 / count as f64 });
        let gap = distance - right - left_of_next;
        if index < last_index && gap > MIN_GAP {
            bins.push(Bin { value: *value, length: gap, mass: 0.0 });
        }
        left = Some(left_of_next);
    }
    bins
}

/// Returns the excess mass of two modes over one: the largest difference, over all densities, between the excess mass
/// of the best two intervals and that of the best single interval. The excess mass of intervals at a density is the
/// share of the values in the intervals, minus the share that a uniform distribution with this density has there.
fn excess_mass(bins: &[Bin]) -> f64 {
    let densities = || bins.iter().filter(|bin| bin.mass > 0.0).map(|bin| bin.mass / bin.length);
    // One interval can also span both intervals and the gap between them. The gap costs at most the density times the
    // length of the axis, so that two intervals exceed one by at most this product. A difference of `MIN_EXCESS`
    // therefore needs at least this density.
    let min_density = MIN_EXCESS / bins.iter().map(|bin| bin.length).sum::<f64>();
    let (lowest, highest) =
        densities().fold((min_density, 0.0_f64), |(lo, hi), density| (lo.min(density), hi.max(density)));
    let level = |step: i32| lowest * (highest / lowest).powf(f64::from(step) / f64::from(LEVELS));
    let excess = (0..=LEVELS).map(|step| {
        let gain = |bin: &Bin| bin.mass - level(step) * bin.length;
        let [one, two] = largest_interval_sums(bins.iter().map(gain));
        two - one
    });
    excess.fold(0.0, f64::max)
}

/// Returns the largest sum of an interval of consecutive numbers, and the largest sum of two such intervals. An
/// interval may be empty.
fn largest_interval_sums(gains: impl Iterator<Item = f64>) -> [f64; 2] {
    // Largest sum so far in four states: within the first interval, after it, within the second interval, after it.
    let (mut first, mut after_first, mut second, mut after_second) =
        (f64::NEG_INFINITY, 0.0_f64, f64::NEG_INFINITY, 0.0_f64);
    for gain in gains {
        second = second.max(after_first) + gain;
        after_second = after_second.max(second);
        first = first.max(0.0) + gain;
        after_first = after_first.max(first);
    }
    [after_first, after_second.max(after_first)]
}

/// Divides the values into two groups at the threshold with the largest variance between the groups.
fn divide(bins: &[Bin]) -> Option<TwoModes> {
    let mean: f64 = bins.iter().map(|bin| bin.mass * bin.value.ln()).sum();
    let mut best: Option<(f64, usize, f64)> = None;
    let (mut below, mut sum_below) = (0.0, 0.0);
    for (index, bin) in bins.iter().enumerate().take(bins.len() - 1) {
        below += bin.mass;
        sum_below += bin.mass * bin.value.ln();
        let above = 1.0 - below;
        if above <= 0.0 {
            break;
        }
        let distance = (mean - sum_below) / above - sum_below / below;
        let variance = below * above * distance * distance;
        if best.is_none_or(|(largest_variance, ..)| variance > largest_variance) {
            best = Some((variance, index + 1, above));
        }
    }
    let (_, middle, upper_share) = best?;
    let (lower, upper) = bins.split_at(middle);
    Some(TwoModes { medians: (median(lower)?, median(upper)?), upper_share })
}

/// Returns the value of the bin in which the median of these bins lies.
fn median(bins: &[Bin]) -> Option<f64> {
    let half = bins.iter().map(|bin| bin.mass).sum::<f64>() / 2.0;
    let mut below = 0.0;
    let middle = bins.iter().find(|bin| {
        below += bin.mass;
        below >= half
    });
    middle.map(|bin| bin.value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    fn summary(values: impl Iterator<Item = f64>) -> Summary {
        let mut summary = Summary::default();
        values.for_each(|value| summary.record(value));
        summary
    }

    /// Draws 200 sets of `count` values, or 50 sets if `count` is large. Returns the fraction of the sets in which two
    /// modes are found.
    fn alarms(count: usize, seed: u64, mut value: impl FnMut(&mut SplitMix64) -> f64) -> f64 {
        let sets = if count > 1_000 { 50 } else { 200 };
        let mut noise = SplitMix64::new(seed);
        let mut has_two = || summary((0..count).map(|_| value(&mut noise))).two_modes().is_some();
        (0..sets).filter(|_| has_two()).count() as f64 / f64::from(sets)
    }

    #[test]
    fn log_normal_values_have_one_mode() {
        for (count, seed) in [(100, 1), (300, 2), (1_000, 3), (10_000, 4)] {
            for sigma in [0.05, 0.3, 0.7, 1.2] {
                let durations = alarms(count, seed, |noise| 0.02 * (sigma * noise.normal()).exp());
                let tokens = alarms(count, seed, |noise| (60.0 * (sigma * noise.normal()).exp()).ceil());
                let few_tokens = alarms(count, seed, |noise| (4.0 * (sigma * noise.normal()).exp()).ceil());
                let highest = durations.max(tokens).max(few_tokens);
                assert!(
                    highest <= 0.02,
                    "{count} values, sigma {sigma}: false alarms with durations {durations}, tokens {tokens}, few tokens {few_tokens}"
                );
            }
        }
    }

    #[test]
    fn uniform_and_exponential_values_have_one_mode() {
        for count in [100, 1_000, 10_000] {
            let uniform = alarms(count, 5, |noise| 1.0 + noise.unit());
            let exponential = alarms(count, 6, |noise| 1e-3 - (1.0 - noise.unit()).ln());
            assert!(uniform <= 0.03 && exponential <= 0.02, "{count}: {uniform}, {exponential}");
        }
    }

    #[test]
    fn two_modes_are_found_with_their_medians() {
        for count in [100, 1_000, 10_000] {
            let mut noise = SplitMix64::new(7);
            let short_or_long = |index: usize| if index.is_multiple_of(3) { 300.0 } else { 40.0 };
            let values =
                (0..count).map(|index| (short_or_long(index) * (0.3 * noise.normal()).exp()).round());
            let modes = summary(values).two_modes().expect("two modes");
            let (lower, upper) = modes.medians;
            assert!((lower / 40.0 - 1.0).abs() < 0.2 && (upper / 300.0 - 1.0).abs() < 0.2, "{modes:?}");
            assert!((modes.upper_share - 1.0 / 3.0).abs() < 0.05, "{modes:?}");
        }
        // Answers that are cut off at a limit of 256 tokens.
        let mut noise = SplitMix64::new(8);
        let truncated_answers = summary((0..500).map(|index| {
            if index % 10 < 3 { 256.0 } else { (60.0 * (0.4 * noise.normal()).exp()).round().min(256.0) }
        }));
        let modes = truncated_answers.two_modes().expect("two modes");
        assert!(
            (modes.medians.1 / 256.0 - 1.0).abs() < 0.02 && (modes.upper_share - 0.3).abs() < 0.05,
            "{modes:?}"
        );
    }

    #[test]
    fn two_modes_need_enough_different_and_distant_values() {
        assert_eq!(summary([1.0, 9.0].into_iter().cycle().take(99)).two_modes(), None, "too few");
        assert_eq!(summary([7.0; 500].into_iter()).two_modes(), None);
        assert_eq!(summary([0.0; 500].into_iter()).two_modes(), None);
        assert_eq!(summary([10.0, 11.0].into_iter().cycle().take(500)).two_modes(), None, "too close");
        let one_to_three = [1.0, 2.0, 2.0, 3.0].into_iter().cycle();
        assert_eq!(summary(one_to_three.take(500)).two_modes(), None, "neighbouring whole numbers");
        let two_answers = summary([12.0, 12.0, 13.0, 40.0].into_iter().cycle().take(500)).two_modes();
        assert!(two_answers.is_some_and(|modes| modes.upper_share == 0.25), "{two_answers:?}");
    }
}
