//! What an agent says of clocks, as far as it can be true: shared by the store and the live picture, so that both show
//! the same.

use peernet_clock::{DelaySource, Interval, Offset};
use peernet_stream::{DelayPoint, DelaySecond};

/// The offset with each source once; `None` when its bounds are no interval or exclude the estimate.
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

/// The second without its median where that is below zero or outside its own bounds.
pub fn delays(second: DelaySecond) -> DelaySecond {
    let median = second.median.filter(|it| !it.value.is_negative() && it.bounds.contains(it.value));
    let rate = |rate: &f64| rate.is_finite() && *rate >= 0.0;
    let median = median.map(|it| DelayPoint { bits_per_second: it.bits_per_second.filter(rate), ..it });
    DelaySecond { median, ..second }
}
