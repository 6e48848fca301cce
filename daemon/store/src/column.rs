//! Conversion of counts: SQLite's integers are signed, with 64 bits.

/// Converts a count to its column; one that is too large becomes the largest.
pub(super) fn column(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// Converts a stored count back. It was stored by [`column`] and is therefore not negative.
pub(super) fn count(stored: i64) -> u64 {
    u64::try_from(stored).unwrap_or(0)
}
