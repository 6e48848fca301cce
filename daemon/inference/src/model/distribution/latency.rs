//! Distributions of latencies, and random draws from them.

use std::f64::consts::TAU;

use peernet_statistics::SplitMix64;
use peernet_statistics::number::{counted, significant};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use super::columns::Columns;
use super::data_file::RecordedLatencies;

/// Longest latency, seconds: one day.
pub(super) const MAX_LATENCY_S: f64 = 24.0 * 3600.0;
/// Longest latency, milliseconds.
const MAX_LATENCY_MS: f64 = MAX_LATENCY_S * 1e3;
/// Maximum number of bins of a histogram.
const MAX_BINS: usize = 10_000;

/// Histogram of latencies, as a table of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Histogram {
    /// Edges of the bins, milliseconds, ascending; one edge more than there are bins.
    #[serde(deserialize_with = "finite_edges")]
    pub edges_ms: Vec<f64>,
    /// Number of latencies in each bin.
    pub counts: Vec<u64>,
}

/// Reads edges. NaN and infinity in TOML arrive here as null, because the table was converted to JSON.
fn finite_edges<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let edges = Vec::<Option<f64>>::deserialize(deserializer)?.into_iter().enumerate();
    let finite = edges.map(|(position, edge)| {
        edge.ok_or_else(|| {
            let message = format!(
                "`histogram.edges_ms[{position}]` is nan or inf; write milliseconds from 0 to {MAX_LATENCY_MS}"
            );
            D::Error::custom(message)
        })
    });
    finite.collect()
}

/// Distribution from which latencies are drawn.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum LatencyDistribution {
    /// Recorded latencies, each drawn with the same probability.
    Empirical {
        /// Latencies, and the stages of the model that are not part of the latencies.
        recorded: RecordedLatencies,
        /// Columns of `data.csv`; each latency is the sum of these columns in one row.
        columns: Columns,
    },
    /// Numbers of latencies in bins; within a bin, all latencies are equally probable.
    Histogram(Histogram),
    /// Logarithms of the latencies are normally distributed.
    LogNormal {
        /// Mean of the latencies (not of their logarithms), milliseconds.
        mean_ms: f64,
        /// Standard deviation of the latencies, milliseconds.
        std_ms: f64,
    },
}

impl Histogram {
    /// Checks the histogram.
    ///
    /// # Errors
    /// Returns a description of the defect if no latency can be drawn from the histogram.
    pub(super) fn check(&self) -> Result<(), String> {
        let Self { edges_ms, counts } = self;
        if counts.is_empty() || edges_ms.len() != counts.len() + 1 {
            return Err(format!(
                "{} and {}; give one more edge than counts",
                counted(edges_ms.len() as u64, "edge"),
                counted(counts.len() as u64, "count")
            ));
        }
        if counts.len() > MAX_BINS {
            return Err(format!("{} bins are too many; at most {MAX_BINS}", counts.len()));
        }
        for edge in edges_ms {
            check_ms(*edge)?;
        }
        if let Some(pair) = edges_ms.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(format!("edge {} is not above edge {}; sort the edges", pair[1], pair[0]));
        }
        match counts.iter().try_fold(0_u64, |sum, count| sum.checked_add(*count)) {
            None => Err("the sum of the counts is too large".to_owned()),
            Some(0) => Err("all counts are 0; one at least must be larger".to_owned()),
            Some(_) => Ok(()),
        }
    }

    fn draw(&self, random: &mut SplitMix64) -> f64 {
        let total: u64 = self.counts.iter().sum();
        let mut position = random.unit() * total as f64;
        let fraction_in_bin = random.unit();
        let mut drawn = self.edges_ms.first().copied().unwrap_or_default();
        // Because of rounding, `position` may lie beyond the last bin. The latency is then in the last non-empty bin.
        for (count, edges) in
            self.counts.iter().zip(self.edges_ms.windows(2)).filter(|(count, _)| **count > 0)
        {
            drawn = edges[0] + fraction_in_bin * (edges[1] - edges[0]);
            position -= *count as f64;
            if position < 0.0 {
                break;
            }
        }
        drawn / 1e3
    }
}

impl LatencyDistribution {
    /// Returns a random latency, seconds: 0 to [`MAX_LATENCY_S`].
    pub(super) fn draw(&self, random: &mut SplitMix64) -> f64 {
        let drawn = match self {
            Self::Empirical { recorded: RecordedLatencies { latencies, .. }, .. } => {
                let position = (random.unit() * latencies.len() as f64) as usize;
                latencies.get(position).copied().unwrap_or_default()
            }
            Self::Histogram(histogram) => histogram.draw(random),
            Self::LogNormal { mean_ms, std_ms } => {
                // If a log-normal distribution has the mean m and the standard deviation s, its logarithms have the
                // variance σ² = ln(1 + s²/m²) and the mean μ = ln m − σ²/2.
                let variance = (std_ms / mean_ms).powi(2).ln_1p();
                let location = mean_ms.ln() - variance / 2.0;
                (location + variance.sqrt() * normal(random)).exp() / 1e3
            }
        };
        drawn.clamp(0.0, MAX_LATENCY_S)
    }

    /// Returns a description for the facts of a run, such as `a log-normal distribution with mean 80 ms and …`.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Empirical { recorded: RecordedLatencies { latencies, omitted_stages }, columns } => {
                let mean = latencies.iter().sum::<f64>() / latencies.len() as f64;
                let count = counted(latencies.len() as u64, "iteration");
                let noun = if columns.names().len() == 1 { "column" } else { "columns" };
                let mean = significant(mean * 1e3);
                let omitted = if omitted_stages.is_empty() {
                    String::new()
                } else {
                    format!(", without {}", describe_stages(omitted_stages))
                };
                format!("{noun} {columns} of {count} of a data.csv, with mean {mean} ms{omitted}")
            }
            Self::Histogram(Histogram { edges_ms, counts }) => {
                let [lowest, highest] =
                    [edges_ms.first(), edges_ms.last()].map(|edge| edge.copied().unwrap_or_default());
                let values = counted(counts.iter().sum(), "value");
                let bins = counted(counts.len() as u64, "bin");
                format!(
                    "a histogram of {values} in {bins} from {lowest} to {highest} ms, uniform within a bin"
                )
            }
            Self::LogNormal { mean_ms, std_ms } => {
                format!("a log-normal distribution with mean {mean_ms} ms and standard deviation {std_ms} ms")
            }
        }
    }
}

/// Describes stages with their means in seconds, such as `preprocessing (mean 339 ms) and postprocessing (mean 12.0
/// ms)`.
pub(super) fn describe_stages(stages: &[(String, f64)]) -> String {
    let described =
        stages.iter().map(|(stage, mean_s)| format!("{stage} (mean {} ms)", significant(mean_s * 1e3)));
    described.collect::<Vec<_>>().join(" and ")
}

/// Checks a latency of the configuration, milliseconds.
///
/// # Errors
/// Returns a description of the defect if `latency` is not a number from 0 to one day.
pub(super) fn check_ms(latency: f64) -> Result<(), String> {
    if (0.0..=MAX_LATENCY_MS).contains(&latency) {
        Ok(())
    } else {
        Err(format!("{latency} is not a latency; write milliseconds from 0 to {MAX_LATENCY_MS}"))
    }
}

/// Returns a number of the standard normal distribution (G. E. P. Box and M. E. Muller, *A note on the generation of
/// random normal deviates*, 1958).
// `SplitMix64::normal` returns no values beyond ±6, and too few beyond ±3: the slowest latencies would be too short.
fn normal(random: &mut SplitMix64) -> f64 {
    // 1 − u is never 0, so the logarithm is finite.
    let radius = (-2.0 * (1.0 - random.unit()).ln()).sqrt();
    radius * (TAU * random.unit()).cos()
}

#[cfg(test)]
mod tests {
    use peernet_statistics::Moments;

    use super::*;

    /// Returns the mean, the standard deviation and the 99th percentile of many draws, seconds.
    fn moments_of_draws(distribution: &LatencyDistribution) -> [f64; 3] {
        let mut random = SplitMix64::new(7);
        let mut drawn: Vec<f64> = (0..200_000).map(|_| distribution.draw(&mut random)).collect();
        let moments: Moments = drawn.iter().copied().collect();
        drawn.sort_by(f64::total_cmp);
        [moments.mean, moments.std().expect("many draws"), drawn[drawn.len() * 99 / 100]]
    }

    fn assert_close(drawn: f64, expected: f64) {
        assert!((drawn / expected - 1.0).abs() < 0.02, "{drawn} instead of {expected}");
    }

    #[test]
    fn log_normal_draws_have_configured_moments() {
        let [mean, std, p99] =
            moments_of_draws(&LatencyDistribution::LogNormal { mean_ms: 80.0, std_ms: 40.0 });
        assert_close(mean, 0.080);
        assert_close(std, 0.040);
        // exp(μ + 2.3263 σ) with σ² = ln 1.25 and μ = ln 80 − σ²/2.
        assert_close(p99, 0.21476);
        let [mean, std, _] = moments_of_draws(&LatencyDistribution::LogNormal { mean_ms: 5.0, std_ms: 0.0 });
        assert!(
            (mean - 0.005).abs() < 1e-12 && std < 1e-12,
            "with a standard deviation of 0, each draw is the mean"
        );
    }

    #[test]
    fn histogram_draws_follow_counts() {
        let histogram = Histogram { edges_ms: vec![0.0, 10.0, 20.0, 40.0], counts: vec![3, 0, 1] };
        histogram.check().expect("is valid");
        let [mean, _, p99] = moments_of_draws(&LatencyDistribution::Histogram(histogram.clone()));
        assert_close(mean, 0.75 * 0.005 + 0.25 * 0.030);
        assert_close(p99, 0.0392);
        let mut random = SplitMix64::new(1);
        let drawn = || histogram.draw(&mut random);
        let drawn: Vec<f64> = std::iter::repeat_with(drawn).take(1000).collect();
        assert!(drawn.iter().all(|drawn| *drawn < 0.010 || *drawn >= 0.020), "the second bin is empty");
    }

    #[test]
    fn empirical_draws_are_recorded_latencies() {
        let latencies = vec![0.001, 0.002, 0.004];
        let recorded = RecordedLatencies { latencies: latencies.clone(), omitted_stages: Vec::new() };
        let empirical = LatencyDistribution::Empirical { recorded, columns: Columns::default() };
        let [mean, _, _] = moments_of_draws(&empirical);
        assert_close(mean, 0.007 / 3.0);
        let mut random = SplitMix64::new(1);
        assert!((0..100).all(|_| latencies.contains(&empirical.draw(&mut random))));
    }

    #[test]
    fn invalid_histogram_is_refused_with_reason() {
        for (edges_ms, counts, reason) in [
            (vec![1.0, 2.0], vec![1, 2], "2 edges and 2 counts; give one more edge than counts"),
            (vec![1.0], vec![], "1 edge and 0 counts"),
            (vec![2.0, 1.0], vec![1], "edge 1 is not above edge 2"),
            (vec![-1.0, 1.0], vec![1], "-1 is not a latency"),
            (vec![f64::NAN, 1.0], vec![1], "NaN is not a latency"),
            (vec![1.0, 2.0], vec![0], "all counts are 0"),
            (vec![1.0, 2.0, 3.0], vec![u64::MAX, 1], "too large"),
        ] {
            let error = Histogram { edges_ms, counts }.check().expect_err(reason);
            assert!(error.contains(reason), "{error}");
        }
    }
}
