//! Message in one direction, with its delay.

use peernet_clock::OneWayDelay;
use peernet_logger::{Name, Tree, stage};

use crate::rows::judged_delay;

/// Message in one direction whose size is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Payload, bytes.
    pub payload_bytes: u64,
    /// Metadata, bytes.
    pub metadata_bytes: u64,
    /// Delay of the message, with its bounds if they are known. The delay is judged: the clock relation gave it a
    /// verdict.
    pub delay: OneWayDelay,
}

impl Passage {
    /// Returns the message from edge to cloud; `None` if it was never sent, or its delay was never judged.
    pub fn up(tree: &Tree) -> Option<Self> {
        Self::from_tree(tree, [stage::UPLOAD, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES])
    }

    /// Returns the message from cloud to edge; `None` if it was never sent, or its delay was never judged.
    pub fn down(tree: &Tree) -> Option<Self> {
        Self::from_tree(tree, [stage::DOWNLOAD, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES])
    }

    fn from_tree(tree: &Tree, [transit, payload, metadata]: [Name; 3]) -> Option<Self> {
        let value = |name: &str| tree.find(&[name])?.1.measure.value();
        Some(Self {
            payload_bytes: value(&payload)? as u64,
            metadata_bytes: value(&metadata)? as u64,
            delay: judged_delay(tree, &transit)?,
        })
    }

    /// Returns the size of payload and metadata, bytes.
    pub fn wire_bytes(&self) -> u64 {
        self.payload_bytes + self.metadata_bytes
    }
}
