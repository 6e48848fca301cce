//! Answers to questions, one file per subject. The statements stand together in [`sql`], where a test looks at
//! all of their plans.

pub(super) mod clocks;
mod comparison;
pub(super) mod incidents;
pub(super) mod iterations;
pub(in crate::store) mod recompute;
pub(super) mod runs;
pub(crate) mod sql;
pub(super) mod statistics;
pub(super) mod tree;

use peernet_clock::WallTime;
use peernet_logger::Slug;

use crate::error::StoreError;

pub(super) fn corrupt(what: &'static str, detail: impl std::fmt::Display) -> StoreError {
    StoreError::Corrupt { what, detail: detail.to_string() }
}

/// Reads a text as what it must be.
pub(super) fn parse<T: std::str::FromStr<Err: std::fmt::Display>>(
    what: &'static str,
    text: &str,
) -> Result<T, StoreError> {
    text.parse().map_err(|error| corrupt(what, error))
}

pub(super) fn name(what: &'static str, text: Option<&str>) -> Result<Option<Slug>, StoreError> {
    text.map(|text| parse(what, text)).transpose()
}

/// A count that is never negative.
pub(in crate::store) fn count(value: i64) -> u64 {
    u64::try_from(value).unwrap_or(0)
}

pub(super) fn wall(nanos: i64) -> WallTime {
    WallTime::from_unix_nanos(nanos)
}
