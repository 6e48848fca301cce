//! Mean of scores with its confidence interval. The scores are shares, such as the mean average precision of a picture,
//! or they are returns of episodes.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Mean of scores.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanScore {
    /// The mean.
    pub mean: f64,
    /// 95 % confidence interval of the mean, within the range of the scores; `None` for a single score.
    pub interval: Option<(f64, f64)>,
    /// Number of scores.
    pub count: u64,
}

impl MeanScore {
    /// Returns the mean of `count` scores, with its interval, from the mean and the sample standard deviation of the
    /// scores. All scores are between `least` and `most`. The interval is that of Student's t for independent scores.
    /// `None` without a score, or if the mean is not within the range.
    pub fn from_statistics(
        count: u64,
        mean: f64,
        std: Option<f64>,
        (least, most): (f64, f64),
    ) -> Option<Self> {
        (count > 0 && (least..=most).contains(&mean)).then_some(())?;
        let interval = std.filter(|_| count > 1).and_then(|std| {
            let n = count as f64;
            let margin = StudentsT::new(0.0, 1.0, n - 1.0).ok()?.inverse_cdf(0.975) * std / n.sqrt();
            Some(((mean - margin).max(least), (mean + margin).min(most)))
        });
        Some(Self { mean, interval, count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(count: u64, mean: f64, std: Option<f64>) -> Option<MeanScore> {
        MeanScore::from_statistics(count, mean, std, (0.0, 1.0))
    }

    #[test]
    fn interval_is_that_of_student() {
        // t with 3 degrees of freedom is 3.18245.
        let found = share(4, 0.5, Some(0.1)).expect("has scores");
        let (low, high) = found.interval.expect("has several");
        assert!((high - 0.5 - 3.18245 * 0.05).abs() < 1e-5, "{found:?}");
        assert!((low - 0.5 + 3.18245 * 0.05).abs() < 1e-5, "{found:?}");
    }

    #[test]
    fn interval_stays_within_range() {
        let interval = |mean, std| share(2, mean, Some(std)).expect("has two scores").interval;
        assert_eq!(interval(0.5, 0.5_f64.sqrt()), Some((0.0, 1.0)));
        assert_eq!(interval(1.0, 0.0), Some((1.0, 1.0)));
        let single = MeanScore { mean: 0.25, interval: None, count: 1 };
        assert_eq!((share(1, 0.25, None), share(0, 0.0, None)), (Some(single), None));
        assert_eq!(share(9, 7.0, None), None, "7 is not a mean of shares");
    }
}
