//! One iteration of the sweep.

use peernet_clock::{Direction, OneWayDelay, Verdict};
use peernet_logger::stream::{Iteration, Outcome};
use peernet_logger::{Measure, Tree, stage};

/// One iteration of the sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Its number in the run, from 1.
    pub number: u64,
    /// When it began, seconds of the edge's wall clock since the Unix epoch.
    pub at: f64,
    /// Payload, bytes.
    pub payload_bytes: u64,
    /// Kept, but left out of the study.
    pub warm_up: bool,
    /// `ok`, `failed`, `lost` or `timeout`.
    pub outcome: &'static str,
    /// Why there was no answer, where somebody said so.
    pub reason: Option<String>,
    /// From its start to its end, seconds.
    pub total: Option<f64>,
    /// Edge to cloud; `None` when it was never sent or never judged.
    pub up: Option<Passage>,
    /// Cloud to edge.
    pub down: Option<Passage>,
}

/// A message one way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Payload, bytes.
    pub payload_bytes: u64,
    /// Metadata, bytes.
    pub logger_bytes: u64,
    /// What is known of its delay.
    pub delay: OneWayDelay,
}

impl Sample {
    /// What an iteration of a payload of `payload_bytes` measured.
    pub fn new(iteration: &Iteration, payload_bytes: u64) -> Self {
        let tree = &iteration.tree;
        let at = tree.anchors().first().map_or(0.0, |anchor| anchor.wall.unix_nanos() as f64 * 1e-9);
        Self {
            number: iteration.number,
            at,
            payload_bytes,
            warm_up: iteration.warm_up,
            outcome: iteration.outcome.name(),
            reason: iteration.outcome.reason().map(str::to_owned),
            total: value(tree, &stage::TOTAL),
            up: passage(tree, [stage::UPLOAD, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES]),
            down: passage(tree, [stage::DOWNLOAD, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES]),
        }
    }

    /// Whether the study rests on it.
    pub fn counts(&self) -> bool {
        !self.warm_up && self.outcome == Outcome::Ok.name()
    }

    /// The message one way.
    pub fn passage(&self, direction: Direction) -> Option<&Passage> {
        match direction {
            Direction::Up => self.up.as_ref(),
            Direction::Down => self.down.as_ref(),
        }
    }
}

impl Passage {
    /// Payload and metadata, bytes.
    pub fn wire_bytes(&self) -> u64 {
        self.payload_bytes + self.logger_bytes
    }

    /// The delay in seconds, where it is known: one near a step or from contradicting sources is not.
    pub fn seconds(&self) -> Option<f64> {
        let known = matches!(self.delay.verdict, Verdict::Ok | Verdict::Limited | Verdict::Stale);
        self.delay.value.filter(|_| known).map(peernet_clock::Span::seconds)
    }

    /// The delay's bounds in seconds.
    pub fn bounds(&self) -> Option<(f64, f64)> {
        self.seconds()?;
        self.delay.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
    }
}

fn value(tree: &Tree, name: &str) -> Option<f64> {
    tree.find(&[name])?.1.measure.value()
}

fn passage(tree: &Tree, [transit, payload, metadata]: [peernet_logger::Name; 3]) -> Option<Passage> {
    let Measure::Transit(transit) = &tree.find(&[transit.as_str()])?.1.measure else { return None };
    Some(Passage {
        payload_bytes: value(tree, &payload)? as u64,
        logger_bytes: value(tree, &metadata)? as u64,
        delay: transit.delay?,
    })
}
