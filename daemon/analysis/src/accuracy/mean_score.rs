//! Mean of scores that are shares, such as the mean average precision of a picture.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Mean of the scores of iterations, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanScore {
    /// The mean.
    pub mean: f64,
    /// 95 % confidence interval of the mean, within 0 and 1; `None` for a single score.
    pub interval: Option<(f64, f64)>,
    /// Number of scores.
    pub count: u64,
}

impl MeanScore {
    /// Returns the mean of scores from 0 to 1; `None` without a score. The interval is that of Student's t for independent scores.
    pub fn from_scores(scores: &[f64]) -> Option<Self> {
        let count = scores.len() as f64;
        (!scores.is_empty()).then_some(())?;
        let mean = scores.iter().sum::<f64>() / count;
        let squares: f64 = scores.iter().map(|score| (score - mean).powi(2)).sum();
        let interval = (scores.len() > 1).then(|| {
            let error = (squares / (count - 1.0) / count).sqrt();
            let margin = StudentsT::new(0.0, 1.0, count - 1.0).ok()?.inverse_cdf(0.975) * error;
            Some(((mean - margin).max(0.0), (mean + margin).min(1.0)))
        });
        Some(Self { mean, interval: interval.flatten(), count: scores.len() as u64 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interval_is_that_of_student() {
        // Mean 0.5, standard deviation 0.1, t with 3 degrees of freedom 3.18245.
        let spread = 0.1 * 0.75_f64.sqrt();
        let found = MeanScore::from_scores(&[0.5 - spread, 0.5 + spread, 0.5 - spread, 0.5 + spread]);
        let found = found.expect("has scores");
        let (low, high) = found.interval.expect("has several");
        assert!((found.mean - 0.5).abs() < 1e-12 && (high - 0.5 - 3.18245 * 0.05).abs() < 1e-5, "{found:?}");
        assert!((low - 0.5 + 3.18245 * 0.05).abs() < 1e-5, "{found:?}");
    }

    #[test]
    fn interval_stays_within_shares() {
        assert_eq!(MeanScore::from_scores(&[0.0, 1.0]).expect("two").interval, Some((0.0, 1.0)));
        assert_eq!(MeanScore::from_scores(&[1.0; 9]).expect("nine").interval, Some((1.0, 1.0)));
        let one = MeanScore { mean: 0.25, interval: None, count: 1 };
        assert_eq!((MeanScore::from_scores(&[0.25]), MeanScore::from_scores(&[])), (Some(one), None));
    }
}
