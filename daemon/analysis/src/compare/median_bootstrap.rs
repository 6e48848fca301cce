//! Difference of two medians, with its interval.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::blocks;
use super::difference::{Difference, have_enough_values};
use crate::order::SortedValues;

/// Number of resamples. With 2000 resamples, the ends of a 95 % interval are the 50th smallest and the 50th largest
/// value.
const RESAMPLES: usize = 2000;
/// Maximum number of pieces of a run. If a run has more values, neighbouring values are joined to pieces before the
/// bootstrap, so that a resample takes the same time for a run of any length. With 2000 pieces the error of an
/// interval's width is about 2 %. More pieces would not help, because the finite number of [`RESAMPLES`] causes an
/// error of the same size.
const MAX_PIECES: usize = 2000;

/// Values of pooled runs.
pub(super) struct PooledValues<'a> {
    /// Values of each run, in the order in which they were measured.
    runs: &'a [Vec<f64>],
    /// Values of all runs together.
    sorted: SortedValues,
}

impl<'a> PooledValues<'a> {
    /// Pools the values of several runs; `runs` has the values of each run.
    pub(super) fn new(runs: &'a [Vec<f64>]) -> Self {
        let sorted = runs.iter().flatten().copied().collect();
        Self { runs, sorted }
    }

    /// Returns the median of all values; `None` without values.
    pub(super) fn median(&self) -> Option<f64> {
        self.sorted.median()
    }

    fn has_enough_values(&self) -> bool {
        have_enough_values(self.runs.iter().map(|run| run.len() as u64))
    }
}

/// Returns the median of `b` minus the median of `a`; `None` if `a` or `b` has no values.
///
/// The ends of the interval are percentiles of the stationary bootstrap (Politis and Romano, JASA 89, 1994). Every run
/// is resampled from its own blocks. The blocks have random lengths, whose mean [`blocks::length`] returns.
///
/// To first order, the median of a resample depends only on the numbers of its values above and below the median of all
/// values (Bahadur, *A note on quantiles in large samples*, Annals of Mathematical Statistics 37, 1966). If the resample
/// has `excess` more values above than expected, its median is the quantile of all values at 0.5 + `excess` / n instead
/// of at 0.5. Values below move the median downwards in the same way. Both numbers are needed, because values may equal
/// the median: if no value is above the median, the median of a resample can still be lower. The excess of a resample is
/// the sum of the excesses of its blocks. The prefix sums of a run give the excess of a block without reading the
/// block's values. The block length, too, is computed from the series of excesses.
pub(super) fn median_difference(a: &PooledValues<'_>, b: &PooledValues<'_>, seed: u64) -> Option<Difference> {
    difference_from_resamples(a, b, seed, RESAMPLES)
}

fn difference_from_resamples(
    a: &PooledValues<'_>,
    b: &PooledValues<'_>,
    seed: u64,
    resamples: usize,
) -> Option<Difference> {
    let (first, second) = (Resampler::new(a)?, Resampler::new(b)?);
    let value = second.median - first.median;
    let interval = (a.has_enough_values() && b.has_enough_values()).then(|| {
        let mut random = StdRng::seed_from_u64(seed);
        let differences = (0..resamples).map(|_| second.draw(&mut random) - first.draw(&mut random));
        let differences: SortedValues = differences.collect();
        Some((differences.quantile(0.025)?, differences.quantile(0.975)?))
    });
    Some(Difference { value, interval: interval.flatten() })
}

/// Pooled values in a form from which resamples are drawn quickly.
struct Resampler<'a> {
    sorted: &'a SortedValues,
    median: f64,
    runs: Vec<RunExcesses>,
}

/// Numbers of values above and below the median of all values, each minus the expected number.
type Excesses = [f64; 2];

/// Excesses of the pieces of a run, stored as prefix sums.
struct RunExcesses {
    /// Sums of the excesses of the first 0, 1, 2, … pieces.
    sums: Vec<Excesses>,
    /// Mean length of a block, in pieces.
    mean_block_length: f64,
}

impl<'a> Resampler<'a> {
    fn new(pooled: &'a PooledValues<'_>) -> Option<Self> {
        let PooledValues { runs, sorted } = pooled;
        let median = pooled.median()?;
        let below = sorted.values().partition_point(|value| *value < median);
        let above = sorted.len() - sorted.values().partition_point(|value| *value <= median);
        let expected_shares = [above, below].map(|count| count as f64 / sorted.len() as f64);
        let excesses = |value: &f64| {
            let is_counted = [*value > median, *value < median].map(|counts| f64::from(u8::from(counts)));
            [is_counted[0] - expected_shares[0], is_counted[1] - expected_shares[1]]
        };
        let run = |values: &Vec<f64>| {
            let pieces = values.chunks(values.len().div_ceil(MAX_PIECES));
            let pieces: Vec<Excesses> =
                pieces.map(|piece| piece.iter().map(excesses).fold([0.0; 2], add)).collect();
            let mut sums = vec![[0.0; 2]];
            sums.extend(pieces.iter().scan([0.0; 2], |sum, piece| {
                *sum = add(*sum, *piece);
                Some(*sum)
            }));
            // If no value equals the median, both excesses of a piece have the same size and different signs.
            let shifts: Vec<f64> = pieces.iter().map(|[above, below]| (above - below) / 2.0).collect();
            RunExcesses { sums, mean_block_length: blocks::length(&shifts) }
        };
        let runs = runs.iter().filter(|values| !values.is_empty()).map(run).collect();
        Some(Self { sorted, median, runs })
    }

    /// Returns the median of one resample.
    fn draw(&self, random: &mut StdRng) -> f64 {
        let mut excesses = [0.0; 2];
        for run in &self.runs {
            run.draw_blocks(random, |from, to| {
                excesses = add(excesses, run.sums[to]);
                excesses = add(excesses, run.sums[from].map(|sum| -sum));
            });
        }
        let [above, below] = excesses.map(|excess| excess / self.sorted.len() as f64);
        let quantile = |share: f64| self.sorted.quantile(share).unwrap_or(self.median);
        let raised = quantile(0.5 + above);
        if raised > self.median { raised } else { quantile(0.5 - below).min(self.median) }
    }
}

fn add(a: Excesses, b: Excesses) -> Excesses {
    [a[0] + b[0], a[1] + b[1]]
}

impl RunExcesses {
    /// Draws blocks at random positions until the blocks together have as many pieces as the run. Calls `take` with the
    /// beginning and the end of each block. The run is circular: a block that reaches beyond the end of the run
    /// continues at the run's beginning, as a second range.
    fn draw_blocks(&self, random: &mut StdRng, mut take: impl FnMut(usize, usize)) {
        let piece_count = self.sums.len() - 1;
        let minus_end_probability = -1.0 / self.mean_block_length;
        let mut missing_pieces = piece_count;
        while missing_pieces > 0 {
            let from = random.random_range(0..piece_count);
            let length = if self.mean_block_length <= 1.0 {
                1
            } else {
                // The length of a block has the geometric distribution with this mean, drawn by inversion.
                let uniform: f64 = random.random_range(f64::MIN_POSITIVE..1.0);
                (uniform.ln() / minus_end_probability.ln_1p()) as usize + 1
            };
            let length = length.min(missing_pieces);
            let to = (from + length).min(piece_count);
            take(from, to);
            take(0, from + length - to);
            missing_pieces -= length;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::autocorrelated_values;
    use super::*;

    fn difference(a: &[Vec<f64>], b: &[Vec<f64>], seed: u64) -> Option<Difference> {
        median_difference(&PooledValues::new(a), &PooledValues::new(b), seed)
    }

    /// Returns how many of 100 intervals contain the true difference, which is 0.5. Each interval
    /// compares two runs of `count` values. To save time, it is computed from 300 resamples.
    fn coverage(count: usize, correlation: f64) -> usize {
        let contains = |seed: u64| {
            let [a, b] = [(10.0, 2 * seed), (10.5, 2 * seed + 1)]
                .map(|(mean, seed)| [autocorrelated_values(correlation, count, mean, seed)]);
            let difference =
                difference_from_resamples(&PooledValues::new(&a), &PooledValues::new(&b), seed, 300)
                    .expect("values");
            let (lo, hi) = difference.interval.expect("enough values");
            lo <= 0.5 && 0.5 <= hi
        };
        (0..100).filter(|seed| contains(*seed)).count()
    }

    #[test]
    fn interval_contains_truth_as_often_as_it_says() {
        let (independent, dependent) = (coverage(300, 0.0), coverage(300, 0.6));
        assert!(independent >= 90, "{independent} % of the intervals of independent values");
        assert!(dependent >= 88, "{dependent} % of the intervals of dependent values");
        let in_pieces = coverage(2 * MAX_PIECES + 1, 0.6);
        assert!(in_pieces >= 88, "{in_pieces} % of the intervals of values that are joined to pieces");
    }

    /// The expected interval of independent values is 1.96 standard errors of 1 / (2 f √n); the density f of the sum of
    /// three uniform values is 3 / 8 in the middle.
    #[test]
    fn long_run_has_interval_of_textbook() {
        let [a, b] =
            [(0.0, 1), (0.5, 2)].map(|(mean, seed)| [autocorrelated_values(0.0, 50_000, mean, seed)]);
        let found = difference(&a, &b, 3).expect("values");
        let (lo, hi) = found.interval.expect("enough values");
        let expected = 1.96 * (2.0_f64 / 50_000.0).sqrt() * 4.0 / 3.0;
        assert!(((hi - lo) / 2.0 / expected - 1.0).abs() < 0.1, "{lo} {hi}, not ±{expected}");
        assert!((lo + hi - 2.0 * found.value).abs() < 0.3 * expected, "{lo} {hi}");
    }

    #[test]
    fn median_of_frequent_values_stays_among_them() {
        // One fifth of the values is two less than the median and one fifth is one less; the rest is the median itself.
        let frequent_values =
            |add: f64| (0..400).map(|n: i32| add + f64::from((n % 5).min(2) - 1)).collect::<Vec<_>>();
        let found = difference(&[frequent_values(0.0)], &[frequent_values(3.0)], 1).expect("values");
        assert_eq!((found.value, found.interval), (3.0, Some((3.0, 3.0))));
        // If all values are equal, every resample has the same median, whether the number of values is even or odd.
        let same = difference(&[vec![2.0; 40]], &[vec![3.5; 31]], 1).expect("values");
        assert_eq!((same.value, same.interval, same.is_distinct()), (1.5, Some((1.5, 1.5)), Some(true)));
    }

    #[test]
    fn median_among_equal_values_can_move_to_both_sides() {
        // 46 of 100 values are 1 and 54 are 2, so that the median of many resamples is 1.
        let noise = autocorrelated_values(0.0, 100, 0.0, 1);
        let mut sorted = noise.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let values: Vec<f64> = noise.iter().map(|x| if *x < sorted[46] { 1.0 } else { 2.0 }).collect();
        let mirrored: Vec<f64> = values.iter().map(|value| 3.0 - value).collect();
        let from_zero = |values: Vec<f64>| difference(&[vec![0.0; 100]], &[values], 1).expect("values");
        let (found, found_mirrored) = (from_zero(values), from_zero(mirrored));
        assert_eq!((found.value, found_mirrored.value), (2.0, 1.0));
        assert_eq!(found.interval, Some((1.0, 2.0)));
        assert_eq!(found_mirrored.interval, Some((1.0, 2.0)));
    }

    #[test]
    fn same_seed_gives_same_interval() {
        let (a, b) = ([autocorrelated_values(0.3, 100, 1.0, 1)], [autocorrelated_values(0.3, 120, 1.2, 2)]);
        assert_eq!(difference(&a, &b, 7), difference(&a, &b, 7));
        assert_ne!(difference(&a, &b, 7), difference(&a, &b, 8));
    }

    #[test]
    fn few_values_have_difference_without_interval() {
        let few = difference(&[vec![1.0; 29]], &[vec![2.0; 300]], 1).expect("values");
        assert_eq!((few.value, few.interval, few.is_distinct()), (1.0, None, None));
        assert_eq!(difference(&[Vec::new()], &[vec![1.0]], 1), None);
    }
}
