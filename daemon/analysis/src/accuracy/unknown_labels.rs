//! Samples whose label is not a class of the model. No answer to them can be right, so they count as neither right nor wrong.

use peernet_statistics::number::{counted, fixed};

use crate::rows::Rows;

/// The column that is 1 for such a sample.
pub const UNKNOWN_LABEL: &str = "unknown-label";
/// Names of the facts of a run that contain examples behind a count: `100 of 100: dented, good`, `4: good, scratched, …`.
const LABELS_FACT: &str = "Labels";
const CLASSES_FACT: &str = "Classes";

/// Count of the iterations whose label is not a class of the model, with an example of the words of either side.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownLabels {
    /// Number of counted iterations with such a label; at least one.
    pub count: u64,
    /// Text ` (the data set says …; the model knows …)`; empty if neither is known.
    examples: String,
}

impl UnknownLabels {
    /// Returns the unknown labels of a run with these facts, which contain examples; `None` if `count` is 0.
    pub fn new(count: u64, facts: &[(String, String)]) -> Option<Self> {
        let example = |fact: &str, side: &str| {
            let (_, text) = facts.iter().find(|(name, _)| name == fact)?;
            let (_, words) = text.split_once(": ")?;
            Some(format!("{side} {words}"))
        };
        let sides = [example(LABELS_FACT, "the data set says"), example(CLASSES_FACT, "the model knows")];
        let sides: Vec<String> = sides.into_iter().flatten().collect();
        let examples = if sides.is_empty() { String::new() } else { format!(" ({})", sides.join("; ")) };
        (count > 0).then_some(Self { count, examples })
    }

    /// Counts the rows with an unknown label among those that count.
    pub fn from_rows(rows: &Rows, facts: &[(String, String)]) -> Option<Self> {
        Self::new(rows.counted_values(UNKNOWN_LABEL).filter(|is| *is == 1.0).count() as u64, facts)
    }

    /// Adds the count of another run; the examples stay those of this one.
    #[must_use]
    pub(crate) fn merged_with(self, other: &Self) -> Self {
        Self { count: self.count + other.count, ..self }
    }

    /// Returns a sentence; `all` is the number of iterations that count.
    pub fn sentence(&self, all: u64) -> String {
        let of = format!("{} of {}", fixed(self.count as f64, 0), counted(all, "iteration"));
        format!("Not scored: {of}, {}.", self.reason())
    }

    /// Returns why they have no score, with examples.
    pub fn reason(&self) -> String {
        format!("because the label is no class of the model{}", self.examples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(facts: &[(&str, &str)]) -> String {
        let facts: Vec<_> =
            facts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        UnknownLabels::new(2, &facts).expect("two").sentence(1_000)
    }

    #[test]
    fn the_words_of_both_sides_are_shown_where_they_are_known() {
        let labels = ("Labels", "30 of 30: dented, good");
        let classes = ("Classes", "1000: tench, goldfish, …");
        let plain = "Not scored: 2 of 1,000 iterations, because the label is no class of the model";
        assert_eq!(
            sentence(&[labels, classes]),
            format!("{plain} (the data set says dented, good; the model knows tench, goldfish, …).")
        );
        assert_eq!(sentence(&[classes]), format!("{plain} (the model knows tench, goldfish, …)."));
        assert_eq!(sentence(&[("Labels", "30 of 30")]), format!("{plain}."));
        assert_eq!(UnknownLabels::new(0, &[]), None);
    }
}
