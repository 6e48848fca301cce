//! State of the two clocks during the study.

use peernet_clock::{RelatedClocks, Span};
use peernet_stream::ClockSample;
use serde::Serialize;

use super::sample::Sample;

/// Clock relation during the study, summed up from its samples, one per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Clocks {
    /// Number of samples of the clock relation.
    #[serde(rename = "seconds")]
    pub clock_samples: u64,
    /// Number of occurrences after which the clocks had to be related again: a clock was stepped, a clock drifted
    /// faster than allowed, or the peer read a different clock after it had been away.
    pub steps: u64,
    /// Kind of the two clocks that were related at the end of the study; `None` without samples.
    pub clocks: Option<RelatedClocks>,
    /// Limit of drift that all bounds assume, parts per million; `None` without samples.
    pub max_drift_ppm: Option<f64>,
    /// Assumed limit of the rate at which the drift changes, parts per million per second; `None` without a limit.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// Last estimate of the rate at which the clocks drift apart, parts per million; `None` if there was no estimate.
    pub skew_ppm: Option<f64>,
    /// Offset of the wall clocks, cloud minus edge, that corrected the last known upload delay, seconds; `None` if no
    /// upload delay is known.
    pub offset: Option<f64>,
    /// Shortest round trip of a probe, seconds; `None` if no probe was answered.
    pub round_trip: Option<f64>,
}

impl Clocks {
    /// Summarises the samples of the clock relation, one per second, and the iterations of the study. Clock samples and
    /// iterations are in order of time.
    pub(super) fn new(clock_samples: &[ClockSample], iterations: &[Sample]) -> Self {
        let round_trips = clock_samples.iter().filter_map(|sample| sample.round_trip);
        let offset = |iteration: &Sample| iteration.up.as_ref()?.delay.clock_offset().map(Span::seconds);
        // Each clock relation counts its own restarts. When the peer comes back, a new relation starts to count at
        // zero. Therefore only increases are added up.
        let restarts = clock_samples.iter().map(|sample| u64::from(sample.exchanges.restarts));
        let previous = std::iter::once(0).chain(restarts.clone());
        let reported_steps: u64 =
            restarts.zip(previous).map(|(current, previous)| current.saturating_sub(previous)).sum();
        let with_offset: Vec<&ClockSample> =
            clock_samples.iter().filter(|sample| sample.offset.is_some()).collect();
        let contradictions =
            with_offset.windows(2).filter(|pair| is_contradicted(pair[0], pair[1])).count() as u64;
        Self {
            clock_samples: clock_samples.len() as u64,
            steps: reported_steps + contradictions,
            clocks: clock_samples.last().map(ClockSample::clocks),
            max_drift_ppm: clock_samples.last().map(|sample| sample.max_drift_ppm),
            max_drift_change_ppm_per_s: clock_samples
                .last()
                .and_then(|sample| sample.basis?.max_drift_change_ppm_per_s),
            skew_ppm: clock_samples.iter().rev().find_map(|sample| sample.offset.as_ref()?.drift_ppm()),
            offset: iterations.iter().rev().find_map(offset),
            round_trip: round_trips.map(|trip| trip.min.seconds()).reduce(f64::min),
        }
    }
}

/// Returns whether the two samples are of two relations of the same clocks that cannot both be true. In this case, a
/// clock was set between the two samples, or the peer that came back reads a different clock.
fn is_contradicted(before: &ClockSample, after: &ClockSample) -> bool {
    // A restart is counted as a step already. Offsets between clocks of other kinds cannot be compared.
    let is_new_relation = before.relation_period != after.relation_period
        && after.exchanges.restarts <= before.exchanges.restarts
        && before.clocks() == after.clocks();
    let offsets = before.offset.as_ref().zip(after.offset.as_ref()).filter(|_| is_new_relation);
    let Some((offset_before, offset_after)) = offsets else { return false };
    let ppm = before.max_drift_ppm.max(after.max_drift_ppm);
    let max_drift = (after.at - before.at).abs().drift(ppm);
    offset_before.bounds.hi + max_drift < offset_after.bounds.lo
        || offset_after.bounds.hi + max_drift < offset_before.bounds.lo
}
