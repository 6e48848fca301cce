//! Trait of statistics that can be merged.

/// Statistic that can be merged with another statistic of its kind. The result equals a statistic that recorded the
/// numbers of both.
pub trait Merge {
    /// Adds the numbers of `other`.
    fn merge(&mut self, other: &Self);
}
