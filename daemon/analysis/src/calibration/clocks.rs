//! State of the two clocks during the study.

use peernet_clock::{RelatedClocks, Span};
use peernet_stream::ClockSample;
use serde::Serialize;

use super::sample::Sample;

/// Clock relation during the study, summed up from its samples, one per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Clocks {
    /// Number of samples of the clock relation.
    pub seconds: u64,
    /// Number of events after which the clocks had to be related anew: a clock was stepped, drifted faster than
    /// allowed, or was a different clock after the peer had been away.
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
    /// Summarises the samples of the clock relation (one per second) and the iterations of the study. Both are in order of time.
    pub(super) fn new(seconds: &[ClockSample], samples: &[Sample]) -> Self {
        let round_trips = seconds.iter().filter_map(|second| second.round_trip);
        let offset = |sample: &Sample| {
            let up = sample.up.as_ref().filter(|up| up.delay.known_seconds().is_some())?;
            Some((up.delay.raw - up.delay.value?).seconds())
        };
        // Each clock relation counts its own restarts, and when the peer comes back, a new relation starts at zero. So
        // only increases are added up.
        let restarts = seconds.iter().map(|second| u64::from(second.exchanges.restarts));
        let previous = std::iter::once(0).chain(restarts.clone());
        let reported_steps: u64 =
            restarts.zip(previous).map(|(current, previous)| current.saturating_sub(previous)).sum();
        let with_offset: Vec<&ClockSample> =
            seconds.iter().filter(|second| second.offset.is_some()).collect();
        let contradictions =
            with_offset.windows(2).filter(|pair| is_contradicted(pair[0], pair[1])).count() as u64;
        Self {
            seconds: seconds.len() as u64,
            steps: reported_steps + contradictions,
            clocks: seconds.last().map(ClockSample::clocks),
            max_drift_ppm: seconds.last().map(|second| second.max_drift_ppm),
            max_drift_change_ppm_per_s: seconds
                .last()
                .and_then(|second| second.basis?.max_drift_change_ppm_per_s),
            skew_ppm: seconds.iter().rev().find_map(|second| second.offset.as_ref()?.skew_ppm),
            offset: samples.iter().rev().find_map(offset),
            round_trip: round_trips.map(|trip| trip.min.seconds()).reduce(f64::min),
        }
    }
}

/// Returns whether a new relation of the two clocks and the previous one cannot both be true. If so, a clock was set
/// between the two samples, or the peer that came back reads a different clock.
fn is_contradicted(before: &ClockSample, after: &ClockSample) -> bool {
    let is_new = before.window != after.window
        && after.exchanges.restarts <= before.exchanges.restarts
        && before.clocks() == after.clocks();
    let offsets = before.offset.as_ref().zip(after.offset.as_ref()).filter(|_| is_new);
    let Some((offset_before, offset_after)) = offsets else { return false };
    let ppm = before.max_drift_ppm.max(after.max_drift_ppm);
    let max_drift = Span::from_seconds_f64((after.at - before.at).abs().seconds() * ppm * 1e-6);
    offset_before.bounds.hi + max_drift < offset_after.bounds.lo
        || offset_after.bounds.hi + max_drift < offset_before.bounds.lo
}
