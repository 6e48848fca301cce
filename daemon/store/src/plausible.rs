//! Removal of impossible values from what agents report about clocks. The store and the live state share it, so that both show
//! the same.

use peernet_clock::{DelaySource, Interval, Offset, Span};
use peernet_stream::{DelayPoint, DelaySecond, EstimateBasis};

/// Returns the offset with each source once, or `None` if its bounds are no interval or exclude the estimate.
pub fn offset(offset: &Offset) -> Option<Offset> {
    if !offset.bounds.contains(offset.estimate) {
        return None;
    }
    let mut sources = Vec::<(DelaySource, Interval)>::new();
    for (source, interval) in &offset.sources {
        if interval.lo <= interval.hi && !sources.iter().any(|(known, _)| known == source) {
            sources.push((*source, *interval));
        }
    }
    let skew_ppm = offset.skew_ppm.filter(|skew| skew.is_finite());
    Some(Offset { sources, skew_ppm, ..*offset })
}

/// Returns the basis without numbers that are not finite or negative, and without a proven skew whose ends are reversed.
pub fn basis(basis: EstimateBasis) -> EstimateBasis {
    let change = |change: &f64| change.is_finite() && *change >= 0.0;
    let skew = |(min, max): &(f64, f64)| min.is_finite() && max.is_finite() && min <= max;
    EstimateBasis {
        max_drift_change_ppm_per_s: basis.max_drift_change_ppm_per_s.filter(change),
        proven_skew_ppm: basis.proven_skew_ppm.filter(skew),
        grown_window: basis.grown_window.filter(|age| *age > Span::ZERO),
        ..basis
    }
}

/// Returns the second without its median if that is negative or outside its own bounds.
pub fn delays(second: DelaySecond) -> DelaySecond {
    let median = second.median.filter(|it| !it.value.is_negative() && it.bounds.contains(it.value));
    let rate = |rate: &f64| rate.is_finite() && *rate >= 0.0;
    let median = median.map(|it| DelayPoint { bits_per_second: it.bits_per_second.filter(rate), ..it });
    DelaySecond { median, ..second }
}
