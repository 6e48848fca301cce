//! Samples: typed payload parts, each with a short description.
//!
//! Payloads are [`Bytes`]: cloning a sample copies no payload. `description` has the types that describe
//! the bytes; `media` has the IANA names of media types, for other programs.

mod description;
mod label;
mod mask_label;
mod media;
mod objects_label;
mod printable;

pub use description::{Description, ElementType, MediaType, PixelFormat};
pub use label::{list_examples, normalized_label};
pub use mask_label::MaskLabel;
pub use objects_label::{LabelledObject, ObjectsLabel, iou};
pub use printable::{escaped_line, printable_line, printable_lines};

use bytes::Bytes;
use serde::Deserialize;

/// Sample of a sensor, or answer of a model, with its payload.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The payload in one or several parts, such as the images of two cameras, or an image and its depth.
    pub parts: Vec<Part>,
    /// Origin of the sample, such as a file name; may be empty.
    pub source: String,
    /// Expected answer, if the data set has one.
    pub label: Option<String>,
}

/// One part of a sample or answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Description of the bytes.
    pub description: Description,
    /// The bytes.
    pub bytes: Bytes,
}

/// Class and score of a classifier's answer.
#[derive(Debug, Deserialize)]
pub struct Classification {
    /// Best class.
    pub label: String,
    /// Score of the best class.
    pub score: f64,
}

impl Sample {
    /// Creates a sample of one part, without source and label.
    pub fn from_part(description: Description, bytes: Bytes) -> Self {
        Self { parts: vec![Part { description, bytes }], source: String::new(), label: None }
    }

    /// Returns the first part if it is JSON.
    pub fn json(&self) -> Option<&[u8]> {
        let part = self.parts.first().filter(|part| part.description.media == MediaType::Json)?;
        Some(&part.bytes)
    }

    /// Returns an answer as a classification; `None` for other answers, which may be JSON as well.
    pub fn classification(&self) -> Option<Classification> {
        serde_json::from_slice(self.json()?).ok()
    }

    /// Returns the number of payload bytes of all parts.
    pub fn payload_bytes(&self) -> u64 {
        self.parts.iter().map(|part| part.bytes.len() as u64).sum()
    }
}
