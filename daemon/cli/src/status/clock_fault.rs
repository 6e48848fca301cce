//! Clocks with an artificial error, which is shown wherever they matter.

use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;

use super::Host;

#[derive(Debug, Deserialize)]
pub(super) struct Links {
    pub(super) links: Vec<Link>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Link {
    cloud: String,
    connected: bool,
    now: Option<LinkNow>,
}

#[derive(Debug, Deserialize)]
struct LinkNow {
    cloud_clock: Option<Clock>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Clock {
    #[serde(rename = "rehearsal")]
    faults: Option<ClockFault>,
}

/// Artificial error of a clock.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct ClockFault {
    offset_s: f64,
    drift_ppm: f64,
    steps: Vec<Step>,
}

#[derive(Clone, Debug, Deserialize)]
struct Step {
    at_s: f64,
    by_s: f64,
}

/// Hosts whose clock has an artificial error at present.
pub(super) type FaultyClocks = BTreeMap<String, ClockFault>;

/// Collects the faulty clocks from the reports of the hosts themselves and from those of edges, because a cloud may
/// report to another aggregator.
pub(super) fn faulty_clocks(hosts: &[Host], links: &[Link]) -> FaultyClocks {
    let own_reports =
        hosts.iter().filter(|host| host.connected).map(|host| (&host.name, host.clock.as_ref()));
    let links = links.iter().filter(|link| link.connected);
    let edge_reports =
        links.map(|link| (&link.cloud, link.now.as_ref().and_then(|now| now.cloud_clock.as_ref())));
    edge_reports
        .chain(own_reports)
        .filter_map(|(name, clock)| Some((name.clone(), clock?.faults.clone()?)))
        .collect()
}

impl fmt::Display for ClockFault {
    /// Writes it as in a run's facts: `offset +1000 ms, drift -50 ppm, step +3000 ms after 20 s`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Nanoseconds converted to seconds and back are not exact in binary.
        let milliseconds = |seconds: f64| (seconds * 1e9).round() / 1e6;
        write!(f, "offset {:+} ms", milliseconds(self.offset_s))?;
        if self.drift_ppm != 0.0 {
            write!(f, ", drift {:+} ppm", self.drift_ppm)?;
        }
        for step in &self.steps {
            let after = milliseconds(step.at_s) / 1e3;
            write!(f, ", step {:+} ms after {after} s", milliseconds(step.by_s))?;
        }
        Ok(())
    }
}

/// Marks a state if the clock of one of the hosts has an artificial error.
pub(super) fn with_clock_fault_mark(state: &str, is_faulty: bool) -> String {
    if is_faulty { format!("{state}, clock fault") } else { state.to_owned() }
}
