//! Removal of impossible values from agents' reports about clocks. The store and the live state share these functions,
//! so that both show the same values.

use peernet_clock::{DelaySource, Interval, Offset, Span};
use peernet_stream::{DelayPoint, DelaySecond, EstimateBasis};

/// Returns the offset with at most one interval of each source, without reversed intervals and without a skew that is
/// infinite or NaN. Returns `None` if the estimate is outside the offset's own bounds.
pub fn offset(offset: &Offset) -> Option<Offset> {
    if !offset.bounds.contains(offset.estimate) {
        return None;
    }
    let mut sources = Vec::<(DelaySource, Interval)>::new();
    for (source, interval) in &offset.sources {
        if interval.lo <= interval.hi && !sources.iter().any(|(other, _)| other == source) {
            sources.push((*source, *interval));
        }
    }
    let skew_ppm = offset.skew_ppm.filter(|skew| skew.is_finite());
    Some(Offset { sources, skew_ppm, ..*offset })
}

/// Returns the basis without impossible values: a drift change that is infinite, NaN or negative, a proven skew whose
/// ends are infinite, NaN or reversed, and an age of the oldest exchange that is not positive.
pub fn basis(basis: EstimateBasis) -> EstimateBasis {
    let is_valid_change = |change: &f64| change.is_finite() && *change >= 0.0;
    let is_valid_skew = |(min, max): &(f64, f64)| min.is_finite() && max.is_finite() && min <= max;
    EstimateBasis {
        max_drift_change_ppm_per_s: basis.max_drift_change_ppm_per_s.filter(is_valid_change),
        proven_skew_ppm: basis.proven_skew_ppm.filter(is_valid_skew),
        oldest_exchange_age: basis.oldest_exchange_age.filter(|age| *age > Span::ZERO),
        ..basis
    }
}

/// Returns the delays of one second without impossible values: a median that is negative or outside its own bounds, and
/// a data rate that is infinite, NaN or negative.
pub fn delays(second: DelaySecond) -> DelaySecond {
    let is_valid_rate = |rate: &f64| rate.is_finite() && *rate >= 0.0;
    let median =
        second.median.filter(|median| !median.value.is_negative() && median.bounds.contains(median.value));
    let median = median
        .map(|median| DelayPoint { bits_per_second: median.bits_per_second.filter(is_valid_rate), ..median });
    DelaySecond { median, ..second }
}
