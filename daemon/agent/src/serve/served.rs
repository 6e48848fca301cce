//! What peers were sent.

use peernet_logger::{Tree, stage};
use peernet_statistics::Sketch;

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
