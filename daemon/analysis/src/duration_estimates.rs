//! Estimated durations of the runs of an experiment.

use peernet_statistics::Moments;

/// Estimated duration of a run of each configuration, seconds.
#[derive(Clone, Debug)]
pub struct DurationEstimates {
    /// Duration that was expected before the first run of each configuration; `None` if not known.
    expected: Vec<Option<f64>>,
    /// Durations of the finished runs of each configuration.
    finished: Vec<Moments>,
}

impl DurationEstimates {
    /// Returns estimates from the expected duration of each configuration.
    pub fn new(expected: Vec<Option<f64>>) -> Self {
        let finished = vec![Moments::default(); expected.len()];
        Self { expected, finished }
    }

    /// Adds the duration of a finished run.
    pub fn record_duration(&mut self, configuration: usize, seconds: f64) {
        if let Some(finished) = self.finished.get_mut(configuration) {
            finished.record(seconds);
        }
    }

    /// Returns the estimate for a run of a configuration: the mean of its finished runs or, without any, the expected
    /// duration times the ratio of measured to expected durations so far. `None` if neither is known.
    pub fn duration_s(&self, configuration: usize) -> Option<f64> {
        let finished = self.finished.get(configuration)?;
        if finished.count > 0 {
            return Some(finished.mean);
        }
        let pairs = self.finished.iter().zip(&self.expected);
        let sums = pairs
            .filter_map(|(finished, expected)| Some((finished.sum(), (*expected)? * finished.count as f64)));
        let (measured, expected) = sums.fold((0.0, 0.0), |sums, pair| (sums.0 + pair.0, sums.1 + pair.1));
        let factor = if expected > 0.0 { measured / expected } else { 1.0 };
        Some(self.expected[configuration]? * factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_durations_correct_estimates() {
        let mut estimates = DurationEstimates::new(vec![Some(10.0), Some(20.0), None]);
        assert_eq!([0, 1, 2].map(|index| estimates.duration_s(index)), [Some(10.0), Some(20.0), None]);
        estimates.record_duration(0, 15.0);
        assert_eq!([0, 1, 2].map(|index| estimates.duration_s(index)), [Some(15.0), Some(30.0), None]);
    }
}
