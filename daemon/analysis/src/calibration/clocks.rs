//! State of the two clocks during the study.

use peernet_clock::{RelatedClocks, Span};
use peernet_stream::ClockSample;
use serde::Serialize;

use super::sample::Sample;

/// The clock relation during the study, from its seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Clocks {
    /// Seconds that were reported.
    pub seconds: u64,
    /// Number of times that either clock was stepped, drifted faster than allowed, or was a different clock after the peer had been away.
    pub steps: u64,
    /// Clocks that were related, by the last second.
    pub clocks: Option<RelatedClocks>,
    /// Limit of drift that all bounds assume, parts per million.
    pub max_drift_ppm: Option<f64>,
    /// Assumed limit of the rate at which the drift changes, parts per million per second; `None` without a limit.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// Rate at which the clocks drift apart, by the last estimate; parts per million.
    pub skew_ppm: Option<f64>,
    /// The offset of the wall clocks, cloud minus edge, by which the last delay was corrected; seconds.
    pub offset: Option<f64>,
    /// The shortest round trip of a probe, seconds.
    pub round_trip: Option<f64>,
}

impl Clocks {
    /// Sums up the seconds of one relation and the iterations meanwhile, both in order.
    pub(super) fn new(seconds: &[ClockSample], samples: &[Sample]) -> Self {
        let round_trips = seconds.iter().filter_map(|second| second.round_trip);
        let offset = |sample: &Sample| {
            let up = sample.up.as_ref().filter(|up| up.seconds().is_some())?;
            Some((up.delay.raw - up.delay.value?).seconds())
        };
        // The counter belongs to a relation: it starts at zero again after the peer came back.
        let restarts = seconds.iter().map(|second| u64::from(second.exchanges.restarts));
        let before = std::iter::once(0).chain(restarts.clone());
        let reported_steps: u64 = restarts.zip(before).map(|(now, before)| now.saturating_sub(before)).sum();
        let known: Vec<&ClockSample> = seconds.iter().filter(|second| second.offset.is_some()).collect();
        let contradictions = known.windows(2).filter(|pair| is_contradicted(pair[0], pair[1])).count() as u64;
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

/// Returns whether a new relation of the two clocks excludes the previous relation. Then a clock was set between the two samples, or the
/// peer that came back reads a different clock.
fn is_contradicted(before: &ClockSample, after: &ClockSample) -> bool {
    let is_new = before.window != after.window
        && after.exchanges.restarts <= before.exchanges.restarts
        && before.clocks() == after.clocks();
    let Some((was, is)) = before.offset.as_ref().zip(after.offset.as_ref()).filter(|_| is_new) else {
        return false;
    };
    let ppm = before.max_drift_ppm.max(after.max_drift_ppm);
    let drift = Span::from_seconds_f64((after.at - before.at).abs().seconds() * ppm * 1e-6);
    was.bounds.hi + drift < is.bounds.lo || is.bounds.hi + drift < was.bounds.lo
}
