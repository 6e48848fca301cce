//! What peers were sent.

use peernet_logger::{Tree, stage};
use peernet_statistics::Summary;

/// Who is served, and what peers were sent since the agent started. Answers of the built-in model `calibration` do not
/// count.
#[derive(Clone, Debug, Default)]
pub struct Served {
    /// Sessions that are open.
    pub sessions: usize,
    /// Answers, failures among them.
    pub answers: u64,
    /// Failures.
    pub errors: u64,
    /// Iterations that runs were to have which are over, and that never came here: their edge said so.
    pub missed: u64,
    /// How long the stage `inference` took of those that have it, seconds.
    pub inference: Summary,
}

impl Served {
    /// One more, a failure or not, whose `inference` took so long.
    pub(super) fn add(&mut self, is_error: bool, inference: Option<f64>) {
        self.answers += 1;
        self.errors += u64::from(is_error);
        if let Some(seconds) = inference {
            self.inference.record(seconds);
        }
    }
}

/// How long the stage `inference` took, seconds.
pub(super) fn inference(tree: &Tree) -> Option<f64> {
    tree.find(&[stage::INFERENCE.as_str()])?.1.measure.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_of_inference_is_never_outside_the_values() {
        // The buckets of a sketch are 1 % wide: some of these lie above the middle of theirs, some below.
        for value in (1..=50).map(|n| f64::from(n) * 1.03e-3) {
            let mut served = Served::default();
            served.add(false, Some(value));
            assert_eq!(served.inference.quantile(0.5), Some(value));
        }
    }
}
