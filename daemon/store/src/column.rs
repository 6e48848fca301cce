//! Whole numbers as SQLite keeps them: signed, 64 bits.

/// A count as it is stored; one that is too large stays at the largest.
pub(super) fn column(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// A count that was stored, and is therefore not negative.
pub(super) fn count(stored: i64) -> u64 {
    u64::try_from(stored).unwrap_or(0)
}
