//! The readiness of the aggregator, for orchestrators and pages.

use serde::Serialize;

/// Whether the aggregator stores events.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Readiness {
    /// Batches are stored and acknowledged.
    Ready,
    /// Batches are not acknowledged, so agents keep them; the text states the reason. Storing is retried automatically,
    /// unless the file is damaged.
    NotStoring(String),
}
