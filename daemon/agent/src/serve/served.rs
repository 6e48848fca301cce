//! What peers were sent.

use peernet_logger::{Tree, stage};
use peernet_statistics::Sketch;

/// What peers were sent since the agent started. Answers of the built-in model `calibration` do not count.
#[derive(Clone, Debug, Default)]
pub struct Served {
    /// Answers, failures among them.
    pub answers: u64,
    /// Failures.
    pub errors: u64,
    /// How long the stage `inference` took of those that have it, seconds.
    pub inference: Sketch,
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
