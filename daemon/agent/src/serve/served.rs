//! Counts of the answers that were sent to peers.

use peernet_logger::{Tree, stage};
use peernet_statistics::Summary;

/// Sessions, and answers since the agent started. Answers of the built-in model `calibration` do not count.
#[derive(Clone, Debug, Default)]
pub struct ServedCounts {
    /// Number of open sessions.
    pub sessions: usize,
    /// Number of answers, including failures.
    pub answers: u64,
    /// Number of failures.
    pub errors: u64,
    /// Number of planned iterations of ended runs whose requests never arrived.
    pub missed: u64,
    /// Duration of the stage `inference` in seconds; answers without this stage are left out.
    pub inference: Summary,
}

impl ServedCounts {
    /// Adds an answer with the duration of its `inference` in seconds.
    pub(super) fn add(&mut self, is_error: bool, inference: Option<f64>) {
        self.answers += 1;
        self.errors += u64::from(is_error);
        if let Some(seconds) = inference {
            self.inference.record(seconds);
        }
    }
}

/// Returns the duration of the stage `inference` in seconds.
pub(super) fn inference_duration(tree: &Tree) -> Option<f64> {
    tree.find(&[stage::INFERENCE.as_str()])?.1.measure.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_of_inference_is_never_outside_the_values() {
        // The buckets of a sketch are 1 % wide. Some of these values are above the middle of their bucket, some
        // below.
        for value in (1..=50).map(|n| f64::from(n) * 1.03e-3) {
            let mut served = ServedCounts::default();
            let is_error = false;
            served.add(is_error, Some(value));
            assert_eq!(served.inference.quantile(0.5), Some(value));
        }
    }
}
