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

    /// Returns the message from cloud to edge; `None` when it was never sent or never judged.
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

    /// Returns the delay in seconds. `None` if the verdict says that the delay is not known, for example because a clock stepped or because
    /// the sources contradict each other.
    pub fn seconds(&self) -> Option<f64> {
        let is_known = matches!(self.delay.verdict, Verdict::Ok | Verdict::Limited | Verdict::Stale);
        self.delay.value.filter(|_| is_known).map(Span::seconds)
    }

    /// Returns the bounds of the delay in seconds; `None` if the delay is not known or has no bounds.
    pub fn bounds(&self) -> Option<(f64, f64)> {
        self.seconds()?;
        self.delay.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
    }
}
