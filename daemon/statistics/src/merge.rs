//! What can be added up.

/// A statistic that takes over everything another of its kind was told, as if it had been told it itself.
pub trait Merge {
    /// Adds what `other` holds.
    fn merge(&mut self, other: &Self);
}
