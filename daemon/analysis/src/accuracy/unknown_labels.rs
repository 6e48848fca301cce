//! Samples whose label is not a class of the model. No answer to such a sample can be right, so the answers count as neither right nor wrong.

use peernet_logger::{fact, stage};
use peernet_statistics::number::{count, counted};

use crate::rows::Rows;

/// Number of iterations whose label is not a class of the model, with examples of the labels and of the model's
/// classes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownLabels {
    /// Number of iterations in the statistics whose label is not a class of the model; at least one.
    pub count: u64,
    /// Text ` (labels: …; classes: …)`, or the half of it that is known; empty if neither half is known.
    examples: String,
}

impl UnknownLabels {
    /// Returns the unknown labels of a run. The examples are taken from the facts of the run. `None` if `count` is 0.
    pub fn new(count: u64, facts: &[(String, String)]) -> Option<Self> {
        let example = |fact: &str, heading: &str| {
            let (_, text) = facts.iter().find(|(name, _)| name == fact)?;
            let (_, examples) = text.split_once(": ")?;
            Some(format!("{heading} {examples}"))
        };
        let examples = [example(fact::LABELS, "labels:"), example(fact::CLASSES, "classes:")];
        let examples: Vec<String> = examples.into_iter().flatten().collect();
        let examples =
            if examples.is_empty() { String::new() } else { format!(" ({})", examples.join("; ")) };
        (count > 0).then_some(Self { count, examples })
    }

    /// Returns the unknown labels in these rows, without warm-up and failed iterations. `None` if there are none.
    pub fn from_rows(rows: &Rows, facts: &[(String, String)]) -> Option<Self> {
        let count =
            rows.values_in_statistics(&stage::UNKNOWN_LABEL).filter(|value| *value == 1.0).count() as u64;
        Self::new(count, facts)
    }

    /// Returns the number of iterations whose score is missing for another reason than an unknown label, out of the
    /// `unscored` iterations in the statistics that have no score.
    pub fn other_unscored(unknown: Option<&Self>, unscored: u64) -> u64 {
        unscored.saturating_sub(unknown.map_or(0, |unknown| unknown.count))
    }

    /// Adds the count of another run. The examples stay those of this run.
    #[must_use]
    pub fn merged_with(self, other: &Self) -> Self {
        Self { count: self.count + other.count, ..self }
    }

    /// Returns a sentence on the iterations that were not scored; `total` is the number of iterations in
    /// the statistics.
    pub fn sentence(&self, total: u64) -> String {
        format!("Not scored: {}, {}.", self.iterations(total), self.reason())
    }

    /// Returns the number of iterations whose label is not a class of the model: `2 of 1,000 iterations`.
    pub fn iterations(&self, total: u64) -> String {
        format!("{} of {}", count(self.count), counted(total, "iteration"))
    }

    /// Returns the reason for the missing scores, with examples.
    pub fn reason(&self) -> String {
        format!("because the label is not a class of the model{}", self.examples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(facts: &[(&str, &str)]) -> String {
        let facts: Vec<_> =
            facts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        UnknownLabels::new(2, &facts).expect("two iterations").sentence(1_000)
    }

    #[test]
    fn sentence_has_known_examples_of_labels_and_classes() {
        let labels = ("Labels", "30 of 30: dented, good");
        let classes = ("Classes", "1000: tench, goldfish, …");
        let plain = "Not scored: 2 of 1,000 iterations, because the label is not a class of the model";
        assert_eq!(
            sentence(&[labels, classes]),
            format!("{plain} (labels: dented, good; classes: tench, goldfish, …).")
        );
        assert_eq!(sentence(&[classes]), format!("{plain} (classes: tench, goldfish, …)."));
        assert_eq!(sentence(&[("Labels", "30 of 30")]), format!("{plain}."));
        assert_eq!(UnknownLabels::new(0, &[]), None);
    }
}
