//! Number of delays by verdict.

use peernet_clock::Verdict;

/// Number of delays by verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VerdictCounts([u64; Verdict::ALL.len()]);

impl VerdictCounts {
    /// Adds `count` delays with this verdict.
    pub fn add(&mut self, verdict: Verdict, count: u64) {
        // `Verdict::ALL` has the order of declaration.
        self.0[verdict as usize] += count;
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
