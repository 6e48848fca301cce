//! Measurements of one iteration of a calibration.

use peernet_clock::Direction;
use peernet_logger::stage;
use peernet_stream::Iteration;

use super::passage::Passage;
use crate::rows::Outcome;

/// Measurements of one iteration of a calibration, which sent one payload.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Number of the iteration in the run, from 1.
    pub number: u64,
    /// Start of the iteration, seconds of the edge's wall clock since the Unix epoch.
    pub at: f64,
    /// Payload, bytes.
    pub payload_bytes: u64,
    /// True if the iteration is warm-up. Such samples are written to `samples.csv`, but no result is computed
    /// from them.
    pub warm_up: bool,
    /// Outcome of the iteration.
    pub outcome: Outcome,
    /// Reason for a missing answer, if one was reported.
    pub reason: Option<String>,
    /// Duration of the iteration, seconds; `None` if it was not measured.
    pub total: Option<f64>,
    /// Message from edge to cloud; `None` if it was never sent, or its delay was never judged.
    pub up: Option<Passage>,
    /// Message from cloud to edge; `None` if it was never sent, or its delay was never judged.
    pub down: Option<Passage>,
}

impl Sample {
    /// Returns the measurements of an iteration with a payload of `payload_bytes`.
    pub fn new(iteration: &Iteration, payload_bytes: u64) -> Self {
        let tree = &iteration.tree;
        // The first anchor is the time at which the edge started the tree.
        let at = tree.anchors().first().map_or(0.0, |anchor| anchor.wall.unix_nanos() as f64 * 1e-9);
        Self {
            number: iteration.number,
            at,
            payload_bytes,
            warm_up: iteration.warm_up,
            outcome: Outcome::from(&iteration.outcome),
            reason: iteration.outcome.reason().map(str::to_owned),
            total: tree.find(&[&stage::TOTAL]).and_then(|(_, node)| node.measure.value()),
            up: Passage::up(tree),
            down: Passage::down(tree),
        }
    }

    /// Returns whether statistics include the sample: it was answered and is not warm-up.
    pub fn is_in_statistics(&self) -> bool {
        !self.warm_up && self.outcome == Outcome::Ok
    }

    /// Returns the message in one direction.
    pub fn passage(&self, direction: Direction) -> Option<&Passage> {
        match direction {
            Direction::Up => self.up.as_ref(),
            Direction::Down => self.down.as_ref(),
        }
    }
}
