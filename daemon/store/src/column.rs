//! Conversion between counts, which are unsigned, and the integers of SQLite, which are signed. Both have 64 bits.

/// Converts a count to the value of its column; saturates at the largest integer.
pub(super) fn column(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// Converts the value of a column to a count. The value was stored by [`column`] and is therefore not negative.
pub(super) fn count(stored: i64) -> u64 {
    u64::try_from(stored).unwrap_or(0)
}
