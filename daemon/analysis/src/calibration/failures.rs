//! Payloads that were not answered, with the most frequent reasons.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use peernet_statistics::number::count;
use serde::Serialize;

use super::sample::Sample;
use crate::rows::Outcome;

/// Unanswered payloads with the same outcome. Payloads of the warm-up are left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Failures {
    /// `failed`, `lost` or `timeout`.
    pub outcome: Outcome,
    /// Number of these payloads.
    pub count: u64,
    /// Most frequent reason; `None` when no reason was given.
    pub commonest_reason: Option<String>,
}

impl Failures {
    /// Returns one item for each outcome of the unanswered samples, the most frequent outcome first.
    pub(super) fn by_outcome(samples: &[Sample]) -> Vec<Self> {
        let mut reasons: BTreeMap<Outcome, BTreeMap<Option<&str>, u64>> = BTreeMap::new();
        for sample in samples.iter().filter(|sample| !sample.warm_up && !sample.is_in_statistics()) {
            *reasons.entry(sample.outcome).or_default().entry(sample.reason.as_deref()).or_default() += 1;
        }
        let mut failures: Vec<Self> = reasons
            .into_iter()
            .map(|(outcome, reasons)| {
                let known_reasons = reasons.iter().filter_map(|(reason, count)| Some(((*reason)?, *count)));
                let commonest = known_reasons.max_by_key(|(_, count)| *count);
                let commonest_reason = commonest.map(|(reason, _)| reason.to_owned());
                Self { outcome, count: reasons.values().sum(), commonest_reason }
            })
            .collect();
        failures.sort_by_key(|failures| Reverse(failures.count));
        failures
    }

    /// Returns the number, the outcome in words, and the reason: `4 failed (most often: too large)`.
    fn description(&self) -> String {
        let outcome = self.outcome.display_name();
        let reason = match &self.commonest_reason {
            None => String::new(),
            Some(reason) if self.count == 1 => format!(" ({reason})"),
            Some(reason) => format!(" (most often: {reason})"),
        };
        format!("{} {outcome}{reason}", count(self.count))
    }
}

/// Returns the sentence about payloads without an answer; empty if every payload was answered. `sent` is the number of
/// all payloads without the warm-up.
pub(super) fn sentence(failures: &[Failures], sent: u64) -> String {
    if failures.is_empty() {
        return String::new();
    }
    let unanswered: u64 = failures.iter().map(|failures| failures.count).sum();
    let descriptions: Vec<String> = failures.iter().map(Failures::description).collect();
    format!(
        "{} of {} payloads were not answered: {}",
        count(unanswered),
        count(sent),
        descriptions.join(", ")
    )
}
