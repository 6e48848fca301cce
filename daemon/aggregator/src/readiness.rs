//! What orchestrators and pages ask first.

use serde::Serialize;

/// Whether events are being stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Readiness {
    /// Batches are stored and acknowledged.
    Ready,
    /// Batches are not acknowledged, agents keep them; the text says why. Tried again by itself, unless the file is damaged.
    NotStoring(String),
}
