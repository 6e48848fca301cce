//! Judgement of latencies that were not measured but drawn from a distribution.

use peernet_stream::Grade;

use super::{finding, with_advice};
use crate::trust::{Finding, TrustInput};

/// Returns a finding if the latencies of the model are replayed.
pub(super) fn findings(input: &TrustInput) -> Option<Finding> {
    let replayed = input.replayed.as_ref()?;
    let text = format!("The latencies of the model are replayed, not measured: {replayed}.");
    let advice = "mark the figures as replayed where they are published; they plan for a machine, and do not measure it";
    Some(with_advice(finding("replayed", Grade::Doubtful, text), advice))
}
