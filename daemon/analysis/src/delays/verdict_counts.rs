//! Number of delays by verdict.

use peernet_clock::Verdict;
use peernet_statistics::Merge;
use serde::Serialize;

/// Number of delays by verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct VerdictCounts([u64; Verdict::ALL.len()]);

impl VerdictCounts {
    /// Adds `count` delays with this verdict.
    pub fn add(&mut self, verdict: Verdict, count: u64) {
        // `Verdict::ALL` has the order of declaration. The sum saturates, because another host may report any number.
        let sum = &mut self.0[verdict as usize];
        *sum = sum.saturating_add(count);
    }

    /// Returns the number of all delays.
    pub fn total(self) -> u64 {
        self.0.into_iter().fold(0, u64::saturating_add)
    }

    /// Returns whether there are no delays.
    pub fn is_empty(self) -> bool {
        self.counts().next().is_none()
    }

    /// Returns the number of delays for each verdict that occurs, in the order of [`Verdict::ALL`].
    pub fn counts(self) -> impl Iterator<Item = (Verdict, u64)> {
        Verdict::ALL.iter().copied().zip(self.0).filter(|(_, count)| *count > 0)
    }
}

impl FromIterator<Verdict> for VerdictCounts {
    fn from_iter<I: IntoIterator<Item = Verdict>>(verdicts: I) -> Self {
        let mut counts = Self::default();
        verdicts.into_iter().for_each(|verdict| counts.add(verdict, 1));
        counts
    }
}

impl Merge for VerdictCounts {
    fn merge(&mut self, other: &Self) {
        other.counts().for_each(|(verdict, count)| self.add(verdict, count));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_that_occur_are_in_order() {
        let mut verdicts = VerdictCounts::default();
        assert!(verdicts.is_empty());
        for verdict in Verdict::ALL.iter().rev().filter(|verdict| **verdict != Verdict::Stale) {
            verdicts.add(*verdict, 2);
        }
        let expected = Verdict::ALL.iter().filter(|verdict| **verdict != Verdict::Stale);
        assert!(verdicts.counts().eq(expected.map(|verdict| (*verdict, 2_u64))), "{verdicts:?}");
    }
}
