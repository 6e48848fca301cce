//! Number of missing events, as text.

use peernet_statistics::number::{count, counted};

/// Number of missing events in several gaps together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissingCount {
    /// Number of missing events in the gaps for which this number is known.
    pub known: u64,
    /// True if the number of missing events is unknown for at least one gap.
    pub is_incomplete: bool,
}

impl MissingCount {
    /// Adds up the numbers of missing events of several gaps. 0 stands for a number that is not known.
    pub fn from_gaps(counts: impl Iterator<Item = u64>) -> Self {
        let start = Self { known: 0, is_incomplete: false };
        counts.fold(start, |sum, count| Self {
            known: sum.known.saturating_add(count),
            is_incomplete: sum.is_incomplete || count == 0,
        })
    }

    /// Returns the number: `849`, `at least 849`, `an unknown number`.
    pub fn number(self) -> String {
        match (self.known, self.is_incomplete) {
            (0, true) => "an unknown number".to_owned(),
            (known, true) => format!("at least {}", count(known)),
            (known, false) => count(known),
        }
    }

    /// Returns whether no event is missing.
    pub const fn is_zero(self) -> bool {
        self.known == 0 && !self.is_incomplete
    }

    /// Returns the number with the noun: `1 event`, `at least 849 events`, `an unknown number of events`.
    pub fn events(self) -> String {
        match (self.known, self.is_incomplete) {
            (0, true) => "an unknown number of events".to_owned(),
            (known, true) => format!("at least {}", counted(known, "event")),
            (known, false) => counted(known, "event"),
        }
    }

    /// Returns the beginning of a sentence: `1 event`, `At least 849 events`, `An unknown number of events`.
    pub fn sentence_start(self) -> String {
        let mut text = self.events();
        if let Some(first) = text.get_mut(..1) {
            first.make_ascii_uppercase();
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gap_of_unknown_size_makes_number_lower_bound() {
        let texts = |gaps: &[u64]| {
            let missing = MissingCount::from_gaps(gaps.iter().copied());
            (missing.number(), missing.sentence_start())
        };
        let text = |number: &str, sentence_start: &str| (number.to_owned(), sentence_start.to_owned());
        assert_eq!(texts(&[]), text("0", "0 events"));
        assert_eq!(texts(&[1]), text("1", "1 event"));
        assert_eq!(texts(&[849, 40_000]), text("40,849", "40,849 events"));
        assert_eq!(texts(&[849, 0]), text("at least 849", "At least 849 events"));
        assert_eq!(MissingCount::from_gaps([849, 0].into_iter()).events(), "at least 849 events");
        assert!(MissingCount::from_gaps([].into_iter()).is_zero());
        assert!(!MissingCount::from_gaps([0].into_iter()).is_zero());
        assert_eq!(texts(&[0, 0]), text("an unknown number", "An unknown number of events"));
    }
}
