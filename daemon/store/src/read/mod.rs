//! Queries, one file per subject. All statements are in [`sql`], so that a test can check all query plans.

pub(super) mod clocks;
pub(super) mod episodes;
pub(super) mod incidents;
pub(super) mod iterations;
pub(super) mod measured_time;
pub(super) mod pairs;
pub(crate) mod recompute;
pub(super) mod runs;
pub(crate) mod sql;
pub(super) mod statistics;
pub(super) mod tree;
pub(super) mod trust;
pub(super) mod whole;

use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::Slug;

use crate::column::count;
use crate::error::StoreError;

/// Creates the error for a stored value that this version cannot have written. `what` names the requested data.
pub(super) fn corrupt_data(what: &'static str, detail: impl std::fmt::Display) -> StoreError {
    StoreError::Corrupt { what, detail: detail.to_string() }
}

/// Parses a stored text. `what` names the requested data in errors.
pub(super) fn parse<T: std::str::FromStr<Err: std::fmt::Display>>(
    what: &'static str,
    text: &str,
) -> Result<T, StoreError> {
    text.parse().map_err(|error| corrupt_data(what, error))
}

/// Parses the stored name of a host or another object; `None` for NULL.
pub(super) fn parse_name(what: &'static str, text: Option<&str>) -> Result<Option<Slug>, StoreError> {
    text.map(|text| parse(what, text)).transpose()
}

/// Returns the outcome, the source, the verdict or the pair of related clocks that is stored as a number: its position
/// in `all`.
pub(super) fn value_of_number<T: Copy>(what: &'static str, all: &[T], number: u8) -> Result<T, StoreError> {
    let value = all.get(usize::from(number)).copied();
    value.ok_or_else(|| corrupt_data(what, format_args!("outcome, source, verdict or clocks {number}")))
}

/// One-way delay as the tables `node` and `transit` store it: NULL becomes `None`.
pub(super) struct StoredDelay {
    /// The receiver's stamp minus the sender's stamp.
    pub(super) raw_ns: Option<i64>,
    pub(super) source: Option<u8>,
    pub(super) verdict: Option<u8>,
    /// The estimate, seconds.
    pub(super) value: Option<f64>,
    /// Lower and upper bound, seconds.
    pub(super) bounds: Option<(f64, f64)>,
}

impl StoredDelay {
    /// Returns the delay; `None` if the delay was never judged.
    pub(super) fn into_delay(self, what: &'static str) -> Result<Option<OneWayDelay>, StoreError> {
        let (Some(raw), Some(source), Some(verdict)) = (self.raw_ns, self.source, self.verdict) else {
            return Ok(None);
        };
        let span = Span::from_seconds_f64;
        Ok(Some(OneWayDelay {
            raw: Span::from_nanos(raw),
            value: self.value.map(span),
            bounds: self.bounds.map(|(lo, hi)| Interval { lo: span(lo), hi: span(hi) }),
            source: value_of_number(what, DelaySource::ALL, source)?,
            verdict: value_of_number(what, Verdict::ALL, verdict)?,
        }))
    }
}

/// Converts the value of a column whose name ends in `_ns` to a time on a wall clock.
pub(super) fn wall(nanos: i64) -> WallTime {
    WallTime::from_unix_nanos(nanos)
}
