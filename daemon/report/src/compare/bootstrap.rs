//! How far a difference between two runs is known.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use serde::Serialize;

use super::blocks;
use crate::order::Ordered;

/// Resamples: the ends of a 95 % interval are then the 50th from either side.
const RESAMPLES: usize = 2000;
/// Fewest values of a run that an interval is given of.
const ENOUGH: usize = 30;

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
    /// Whether the interval leaves out zero; `None` where there is no interval.
    pub fn is_distinct(&self) -> Option<bool> {
        self.interval.map(|(lo, hi)| lo > 0.0 || hi < 0.0)
    }
}

/// The difference of a statistic between two groups of runs, each run's values in the order in which they were measured.
///
/// Percentiles of the stationary bootstrap (Politis and Romano, JASA 89, 1994): every run is put together anew from
/// blocks of itself, of random length, as long on average as [`blocks::length`] says. The mean depends on the values
/// themselves and the median, to first order, only on which side of it they lie; so the blocks of the median are as long
/// as *that* series asks for. The percentile method is taken because it holds for medians, and because the
/// acceleration of BCa is computed by leaving out single values, which do not stand alone here.
pub fn difference(a: &[Vec<f64>], b: &[Vec<f64>], statistic: Statistic, seed: u64) -> Option<Difference> {
    resampled(a, b, statistic, seed, RESAMPLES)
}

fn resampled(
    a: &[Vec<f64>],
    b: &[Vec<f64>],
    statistic: Statistic,
    seed: u64,
    resamples: usize,
) -> Option<Difference> {
    let (first, second) = (Group::new(a, statistic)?, Group::new(b, statistic)?);
    let value = second.value - first.value;
    let enough = a.iter().chain(b).all(|run| run.is_empty() || run.len() >= ENOUGH);
    let interval = enough.then(|| {
        let mut random = StdRng::seed_from_u64(seed);
        let mut draws = (first.resampler(), second.resampler());
        let drawn = (0..resamples).map(|_| draws.1.draw(&mut random) - draws.0.draw(&mut random));
        let drawn: Ordered = drawn.collect();
        Some((drawn.quantile(0.025)?, drawn.quantile(0.975)?))
    });
    Some(Difference { value, interval: interval.flatten() })
}

/// Runs that are taken together.
struct Group {
    statistic: Statistic,
    runs: Vec<Run>,
    /// All values, smallest first.
    sorted: Ordered,
    value: f64,
}

/// One run's values in a form that is quickly drawn from.
struct Run {
    /// Sums of the first values: none, one, two, …
    sums: Vec<f64>,
    /// Each value's place among all of the group.
    ranks: Vec<u32>,
    block: f64,
}

impl Group {
    fn new(runs: &[Vec<f64>], statistic: Statistic) -> Option<Self> {
        let sorted: Ordered = runs.iter().flatten().copied().collect();
        let median = sorted.median()?;
        let value = match statistic {
            Statistic::Mean => sorted.values().iter().sum::<f64>() / sorted.len() as f64,
            Statistic::Median => median,
        };
        let run = |values: &Vec<f64>| {
            let block = match statistic {
                Statistic::Mean => blocks::length(values),
                Statistic::Median => {
                    let sides: Vec<f64> =
                        values.iter().map(|value| f64::from(u8::from(*value > median))).collect();
                    blocks::length(&sides)
                }
            };
            let mut sums = vec![0.0];
            sums.extend(values.iter().scan(0.0, |sum, value| {
                *sum += value - median;
                Some(*sum)
            }));
            let rank = |value: &f64| sorted.values().partition_point(|other| other < value) as u32;
            Run { sums, ranks: values.iter().map(rank).collect(), block }
        };
        let runs = runs.iter().filter(|values| !values.is_empty()).map(run).collect();
        Some(Self { statistic, runs, value, sorted })
    }

    fn resampler(&self) -> Resampler<'_> {
        let places = match self.statistic {
            Statistic::Mean => 0,
            Statistic::Median => self.sorted.len(),
        };
        Resampler { group: self, drawn: vec![0; places] }
    }
}

/// Draws the statistic of a group that is put together anew.
struct Resampler<'a> {
    group: &'a Group,
    /// How often each rank was drawn.
    drawn: Vec<u32>,
}

impl Resampler<'_> {
    fn draw(&mut self, random: &mut StdRng) -> f64 {
        match self.group.statistic {
            Statistic::Mean => self.mean(random),
            Statistic::Median => self.median(random),
        }
    }

    /// Sums are of distances from the median, so that they do not lose digits.
    fn mean(&self, random: &mut StdRng) -> f64 {
        let mut sum = 0.0;
        for run in &self.group.runs {
            run.blocks(random, |from, to| sum += run.sums[to] - run.sums[from]);
        }
        let median = self.group.sorted.median().unwrap_or_default();
        median + sum / self.group.sorted.len() as f64
    }

    fn median(&mut self, random: &mut StdRng) -> f64 {
        self.drawn.fill(0);
        for run in &self.group.runs {
            run.blocks(random, |from, to| {
                for rank in &run.ranks[from..to] {
                    self.drawn[*rank as usize] += 1;
                }
            });
        }
        let count = self.group.sorted.len();
        // Both middle ones; the same one where the count is odd.
        let (below, above) = ((count - 1) / 2, count / 2);
        let (mut seen, mut lower) = (0_usize, None);
        for (rank, times) in self.drawn.iter().enumerate() {
            seen += *times as usize;
            if lower.is_none() && seen > below {
                lower = Some(self.group.sorted.values()[rank]);
            }
            if let (Some(lower), true) = (lower, seen > above) {
                return (lower + self.group.sorted.values()[rank]) / 2.0;
            }
        }
        self.group.value
    }
}

impl Run {
    /// Blocks from anywhere, as many values in all as the run has. The run is a circle: after its last value comes its
    /// first.
    fn blocks(&self, random: &mut StdRng, mut take: impl FnMut(usize, usize)) {
        let count = self.ranks.len();
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

    /// How many of 100 intervals contain the true difference of 0.5, in percent.
    fn coverage(keeps: f64, statistic: Statistic) -> usize {
        let contains = |seed: u64| {
            let (a, b) = (run(keeps, 300, 10.0, 2 * seed), run(keeps, 300, 10.5, 2 * seed + 1));
            let difference = resampled(&[a], &[b], statistic, seed, 300).expect("values");
            let (lo, hi) = difference.interval.expect("enough");
            lo <= 0.5 && 0.5 <= hi
        };
        (0..100).filter(|seed| contains(*seed)).count()
    }

    #[test]
    fn intervals_contain_the_truth_as_often_as_they_say() {
        for statistic in [Statistic::Mean, Statistic::Median] {
            let (independent, dependent) = (coverage(0.0, statistic), coverage(0.6, statistic));
            assert!(independent >= 90, "{statistic:?}: {independent} % of independent values");
            assert!(dependent >= 88, "{statistic:?}: {dependent} % of dependent values");
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_interval() {
        let (a, b) = ([run(0.3, 100, 1.0, 1)], [run(0.3, 120, 1.2, 2)]);
        let of = |seed| difference(&a, &b, Statistic::Median, seed);
        assert_eq!(of(7), of(7));
        assert_ne!(of(7), of(8));
    }

    #[test]
    fn resampled_medians_are_the_usual_ones() {
        // With one value many times, and with an even count, whatever is drawn.
        let same = difference(&[vec![2.0; 40]], &[vec![3.5; 31]], Statistic::Median, 1).expect("values");
        assert_eq!((same.value, same.interval), (1.5, Some((1.5, 1.5))));
        assert_eq!(same.is_distinct(), Some(true));
        let mean = difference(&[vec![2.0; 40]], &[vec![3.5; 31]], Statistic::Mean, 1).expect("values");
        assert_eq!((mean.value, mean.interval), (1.5, Some((1.5, 1.5))));
    }

    #[test]
    fn too_few_values_have_a_difference_and_no_interval() {
        let few = difference(&[vec![1.0; 29]], &[vec![2.0; 300]], Statistic::Mean, 1).expect("values");
        assert_eq!((few.value, few.interval, few.is_distinct()), (1.0, None, None));
        assert_eq!(difference(&[Vec::new()], &[vec![1.0]], Statistic::Mean, 1), None);
    }
}
