//! How far a difference between two runs is known.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use serde::Serialize;

use super::blocks;
use crate::order::Ordered;

/// Resamples: the ends of a 95 % interval are then the 50th from either side.
const RESAMPLES: usize = 2000;
/// Fewest values of a run that an interval is given of.
pub(super) const ENOUGH: usize = 30;
/// Most pieces of a run: of a longer one, neighbours stay together from the start. So many tell the width of an interval to
/// 2 %, as its ends are known of so many resamples, and a draw takes the same time however long the run was.
const PIECES: usize = 2000;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Statistic {
    /// The arithmetic mean.
    Mean,
    /// The median.
    Median,
}

/// A difference with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The second less the first.
    pub value: f64,
    /// The interval's ends; `None` with fewer than 30 values in a run.
    pub interval: Option<(f64, f64)>,
}

impl Difference {
    /// Half the width of the interval.
    pub(super) fn margin(self) -> Option<f64> {
        self.interval.map(|(lo, hi)| (hi - lo) / 2.0)
    }

    /// The value, then the interval's ends.
    pub(super) fn ends(self) -> [Option<f64>; 3] {
        [Some(self.value), self.interval.map(|ends| ends.0), self.interval.map(|ends| ends.1)]
    }

    /// Whether the interval leaves out zero; `None` where there is no interval.
    pub fn is_distinct(&self) -> Option<bool> {
        self.interval.map(|(lo, hi)| lo > 0.0 || hi < 0.0)
    }
}

/// Values of runs that are taken together, each run's in the order in which they were measured.
pub struct Sample {
    runs: Vec<Vec<f64>>,
    sorted: Ordered,
}

impl Sample {
    /// Of the values of each run.
    pub fn new(runs: Vec<Vec<f64>>) -> Self {
        let sorted = runs.iter().flatten().copied().collect();
        Self { runs, sorted }
    }

    /// The mean of all values; `None` without any.
    pub fn mean(&self) -> Option<f64> {
        let values = self.sorted.values();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// The median of all values; `None` without any.
    pub fn median(&self) -> Option<f64> {
        self.sorted.median()
    }

    fn is_enough(&self) -> bool {
        self.runs.iter().all(|run| run.is_empty() || run.len() >= ENOUGH)
    }
}

/// The difference of a statistic between two samples.
///
/// Percentiles of the stationary bootstrap (Politis and Romano, JASA 89, 1994): every run is put together anew from
/// blocks of itself, of random length, as long on average as [`blocks::length`] says. The mean depends on the values
/// themselves and the median, to first order, only on which side of it they lie (Bahadur, *A note on quantiles in large
/// samples*, Annals of Mathematical Statistics 37, 1966); so the blocks of the median are as long as *that* series asks
/// for, and the median of a resample is the quantile that is as far from the middle as the resample has more values on
/// one side. Either way a resample is a sum, which the sums of a run's first values give without a look at the values.
/// The percentile method is taken because it holds for medians, and because the acceleration of BCa is computed by
/// leaving out single values, which do not stand alone here.
pub fn difference(a: &Sample, b: &Sample, statistic: Statistic, seed: u64) -> Option<Difference> {
    resampled(a, b, statistic, seed, RESAMPLES)
}

fn resampled(
    a: &Sample,
    b: &Sample,
    statistic: Statistic,
    seed: u64,
    resamples: usize,
) -> Option<Difference> {
    let (first, second) = (Group::new(a, statistic)?, Group::new(b, statistic)?);
    let value = second.value - first.value;
    let interval = (a.is_enough() && b.is_enough()).then(|| {
        let mut random = StdRng::seed_from_u64(seed);
        let drawn = (0..resamples).map(|_| second.draw(&mut random) - first.draw(&mut random));
        let drawn: Ordered = drawn.collect();
        Some((drawn.quantile(0.025)?, drawn.quantile(0.975)?))
    });
    Some(Difference { value, interval: interval.flatten() })
}

/// A sample in a form that is quickly drawn from.
struct Group<'a> {
    statistic: Statistic,
    sorted: &'a Ordered,
    value: f64,
    runs: Vec<Run>,
}

/// How far the values of a run lie from what is usual in the group.
struct Run {
    /// Sums of the first pieces: none, one, two, …
    sums: Vec<f64>,
    /// Mean length of a block, in pieces.
    block: f64,
}

impl<'a> Group<'a> {
    fn new(sample: &'a Sample, statistic: Statistic) -> Option<Self> {
        let Sample { runs, sorted } = sample;
        let (mean, median) = (sample.mean()?, sample.median()?);
        let above = sorted.len() - sorted.values().partition_point(|value| *value <= median);
        let (value, usual) = match statistic {
            Statistic::Mean => (mean, mean),
            Statistic::Median => (median, above as f64 / sorted.len() as f64),
        };
        let far = |of: &f64| match statistic {
            Statistic::Mean => of - usual,
            Statistic::Median => f64::from(u8::from(*of > median)) - usual,
        };
        let run = |values: &Vec<f64>| {
            let pieces = values.chunks(values.len().div_ceil(PIECES));
            let pieces: Vec<f64> = pieces.map(|piece| piece.iter().map(far).sum()).collect();
            let mut sums = vec![0.0];
            sums.extend(pieces.iter().scan(0.0, |sum, piece| {
                *sum += piece;
                Some(*sum)
            }));
            Run { sums, block: blocks::length(&pieces) }
        };
        let runs = runs.iter().filter(|values| !values.is_empty()).map(run).collect();
        Some(Self { statistic, sorted, value, runs })
    }

    /// The statistic of a group that is put together anew.
    fn draw(&self, random: &mut StdRng) -> f64 {
        let mut sum = 0.0;
        for run in &self.runs {
            run.blocks(random, |from, to| sum += run.sums[to] - run.sums[from]);
        }
        let far = sum / self.sorted.len() as f64;
        match self.statistic {
            Statistic::Mean => self.value + far,
            Statistic::Median => self.sorted.quantile(0.5 + far).unwrap_or(self.value),
        }
    }
}

impl Run {
    /// Blocks from anywhere, as many pieces in all as the run has. The run is a circle: after its last piece comes its
    /// first.
    fn blocks(&self, random: &mut StdRng, mut take: impl FnMut(usize, usize)) {
        let count = self.sums.len() - 1;
        let ends = -1.0 / self.block;
        let mut missing = count;
        while missing > 0 {
            let from = random.random_range(0..count);
            let length = if self.block <= 1.0 {
                1
            } else {
                // Geometric, of mean `block`.
                let uniform: f64 = random.random_range(f64::MIN_POSITIVE..1.0);
                (uniform.ln() / ends.ln_1p()) as usize + 1
            };
            let length = length.min(missing);
            let to = (from + length).min(count);
            take(from, to);
            take(0, from + length - to);
            missing -= length;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of which each keeps so much of the one before; seeded.
    fn run(keeps: f64, count: usize, mean: f64, seed: u64) -> Vec<f64> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut last = 0.0;
        let next = |_| {
            // The sum of three is nearly normal.
            let noise: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
            last = keeps * last + noise;
            mean + last
        };
        (0..count).map(next).collect()
    }

    fn sample<const N: usize>(runs: [Vec<f64>; N]) -> Sample {
        Sample::new(runs.into())
    }

    /// How many of 100 intervals of runs of so many values contain the true difference of 0.5, in percent.
    fn coverage(count: usize, keeps: f64, statistic: Statistic) -> usize {
        let contains = |seed: u64| {
            let [a, b] = [(10.0, 2 * seed), (10.5, 2 * seed + 1)]
                .map(|(mean, seed)| sample([run(keeps, count, mean, seed)]));
            let difference = resampled(&a, &b, statistic, seed, 300).expect("values");
            let (lo, hi) = difference.interval.expect("enough");
            lo <= 0.5 && 0.5 <= hi
        };
        (0..100).filter(|seed| contains(*seed)).count()
    }

    #[test]
    fn intervals_contain_the_truth_as_often_as_they_say() {
        for statistic in [Statistic::Mean, Statistic::Median] {
            let (independent, dependent) = (coverage(300, 0.0, statistic), coverage(300, 0.6, statistic));
            assert!(independent >= 90, "{statistic:?}: {independent} % of independent values");
            assert!(dependent >= 88, "{statistic:?}: {dependent} % of dependent values");
            let in_pieces = coverage(2 * PIECES + 1, 0.6, statistic);
            assert!(in_pieces >= 88, "{statistic:?}: {in_pieces} % of values in pieces");
        }
    }

    /// Of independent values: 1.96 standard errors, 1 / √n of a mean and 1 / (2 f √n) of a median; the density f of the sum
    /// of three uniform values is 3 / 8 in the middle.
    #[test]
    fn a_long_run_has_the_interval_of_the_textbook() {
        let [a, b] = [(0.0, 1), (0.5, 2)].map(|(mean, seed)| sample([run(0.0, 50_000, mean, seed)]));
        let error = (2.0_f64 / 50_000.0).sqrt();
        for (statistic, wider) in [(Statistic::Mean, 1.0), (Statistic::Median, 4.0 / 3.0)] {
            let found = difference(&a, &b, statistic, 3).expect("values");
            let (lo, hi) = found.interval.expect("enough");
            let expected = 1.96 * error * wider;
            assert!(
                ((hi - lo) / 2.0 / expected - 1.0).abs() < 0.1,
                "{statistic:?}: {lo} {hi}, not ±{expected}"
            );
            assert!((lo + hi - 2.0 * found.value).abs() < 0.3 * expected, "{statistic:?}: {lo} {hi}");
        }
    }

    #[test]
    fn the_median_of_values_that_come_often_stays_among_them() {
        // Every fifth is one more, every fifth one less; the rest is the median itself.
        let often = |add: f64| {
            (0..400).map(|n: i32| add + f64::from((n % 5).min(2) - 1).max(-1.0)).collect::<Vec<_>>()
        };
        let found =
            difference(&sample([often(0.0)]), &sample([often(3.0)]), Statistic::Median, 1).expect("values");
        assert_eq!((found.value, found.interval), (3.0, Some((3.0, 3.0))));
    }

    #[test]
    fn the_same_seed_gives_the_same_interval() {
        let (a, b) = (sample([run(0.3, 100, 1.0, 1)]), sample([run(0.3, 120, 1.2, 2)]));
        let of = |seed| difference(&a, &b, Statistic::Median, seed);
        assert_eq!(of(7), of(7));
        assert_ne!(of(7), of(8));
    }

    #[test]
    fn resampled_medians_are_the_usual_ones() {
        // With one value many times, and with an even count, whatever is drawn.
        let same = difference(&sample([vec![2.0; 40]]), &sample([vec![3.5; 31]]), Statistic::Median, 1)
            .expect("values");
        assert_eq!((same.value, same.interval), (1.5, Some((1.5, 1.5))));
        assert_eq!(same.is_distinct(), Some(true));
        let mean = difference(&sample([vec![2.0; 40]]), &sample([vec![3.5; 31]]), Statistic::Mean, 1)
            .expect("values");
        assert_eq!((mean.value, mean.interval), (1.5, Some((1.5, 1.5))));
    }

    #[test]
    fn too_few_values_have_a_difference_and_no_interval() {
        let few = difference(&sample([vec![1.0; 29]]), &sample([vec![2.0; 300]]), Statistic::Mean, 1)
            .expect("values");
        assert_eq!((few.value, few.interval, few.is_distinct()), (1.0, None, None));
        assert_eq!(difference(&sample([Vec::new()]), &sample([vec![1.0]]), Statistic::Mean, 1), None);
    }
}
