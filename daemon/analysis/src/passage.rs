//! Message in one direction, with its delay.

use peernet_clock::{OneWayDelay, Span, Verdict};
use peernet_logger::{Measure, Name, Tree, stage};

/// Message in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Payload, bytes.
    pub payload_bytes: u64,
    /// Metadata, bytes.
    pub logger_bytes: u64,
    /// Delay of the message, with its bounds if they are known.
    pub delay: OneWayDelay,
}

impl Passage {
    /// Returns the message from edge to cloud; `None` when it was never sent or never judged.
    pub fn up(tree: &Tree) -> Option<Self> {
        Self::from_tree(tree, [stage::UPLOAD, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES])
    }

    /// Returns the message from cloud to edge.
    pub fn down(tree: &Tree) -> Option<Self> {
        Self::from_tree(tree, [stage::DOWNLOAD, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES])
    }

    fn from_tree(tree: &Tree, [transit, payload, metadata]: [Name; 3]) -> Option<Self> {
        let Measure::Transit(transit) = &tree.find(&[transit.as_str()])?.1.measure else { return None };
        let value = |name: &str| tree.find(&[name])?.1.measure.value();
        Some(Self {
            payload_bytes: value(&payload)? as u64,
            logger_bytes: value(&metadata)? as u64,
            delay: transit.delay?,
        })
    }

    /// Returns the size of payload and metadata, bytes.
    pub fn wire_bytes(&self) -> u64 {
        self.payload_bytes + self.logger_bytes
    }

    /// Returns the delay in seconds if it is known: a delay near a step or from contradicting sources is not.
    pub fn seconds(&self) -> Option<f64> {
        let known = matches!(self.delay.verdict, Verdict::Ok | Verdict::Limited | Verdict::Stale);
        self.delay.value.filter(|_| known).map(Span::seconds)
    }

    /// Returns the delay's bounds in seconds.
    pub fn bounds(&self) -> Option<(f64, f64)> {
        self.seconds()?;
        self.delay.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
    }
}
