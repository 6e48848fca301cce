//! What travels through a pipeline: a sample of typed payload parts, each with a small description.
//!
//! Payloads are [`Bytes`]: cloning a sample copies no payload. `description` says what the bytes are; `media` gives
//! the same in the names that programs of other makers know.

mod description;
mod label;
mod media;
mod printable;

pub use description::{Description, ElementType, MediaType, PixelFormat};
pub use label::{examples, plain_label};
pub use printable::{printable_line, printable_lines};

use bytes::Bytes;

/// What a sensor yields, and what a model answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The payload, in one or several parts (two cameras, an image and its depth).
    pub parts: Vec<Part>,
    /// Where it came from, such as a file name; empty when there is nothing to say.
    pub source: String,
    /// The right answer where the data set knows it.
    pub label: Option<String>,
}

/// One part of a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// What the bytes are.
    pub description: Description,
    /// The bytes themselves.
    pub bytes: Bytes,
}

impl Sample {
    /// A sample of one part.
    pub fn of(description: Description, bytes: Bytes) -> Self {
        Self { parts: vec![Part { description, bytes }], source: String::new(), label: None }
    }

    /// Payload bytes of all parts.
    pub fn payload_bytes(&self) -> u64 {
        self.parts.iter().map(|part| part.bytes.len() as u64).sum()
    }
}
