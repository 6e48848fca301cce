//! Injected clock faults. Every page that shows such a clock, or numbers that depend on it, names the fault.

use std::collections::BTreeMap;

use peernet_aggregator::LiveState;

use super::chip::{Chip, Tone};

/// Chip of a host with an injected clock fault, and of its measurements.
pub(crate) const CHIP: Chip = Chip::new(Tone::Warn, "clock-fault", "clock fault");

/// Hosts with an injected clock fault, by name, with the fault in words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FaultyClocks(pub BTreeMap<String, String>);

impl FaultyClocks {
    /// Collects the clock faults of the hosts in the live state.
    pub(crate) fn of(snapshot: &LiveState) -> Self {
        // The fault of a host that does not report now may have ended, so it is not shown.
        let connected = snapshot.hosts.iter().filter(|host| host.connected);
        let own_faults = connected.filter_map(|host| {
            Some((host.description.name.to_string(), host.clock.faults.as_ref()?.to_string()))
        });
        // A cloud may report to another aggregator. In that case, only its edges report the fault of its clock to this
        // aggregator.
        let links = snapshot.links.iter().filter(|link| link.connected);
        let faults_reported_by_edges = links.filter_map(|link| {
            Some((link.live.peer_name.to_string(), link.live.cloud.as_ref()?.faults.as_ref()?.to_string()))
        });
        // If a host and an edge both report the fault of the host, the map keeps the report that comes last: the host's
        // own.
        Self(faults_reported_by_edges.chain(own_faults).collect())
    }

    /// Returns the sentences of the banner on every page, one per host.
    pub(crate) fn banner(&self) -> Vec<String> {
        let sentence = |(name, fault): (&String, &String)| {
            format!(
                "Clock fault injection: {name}'s clock is made wrong on purpose ({fault}). The measured delays of {name} should stay the same."
            )
        };
        self.0.iter().map(sentence).collect()
    }

    /// Returns the chip if a host with one of these names has a clock fault.
    pub(crate) fn chip(&self, names: &[&str]) -> Option<Chip> {
        names.iter().any(|name| self.0.contains_key(*name)).then_some(CHIP)
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockFaultStep, ClockFaults, Span, SteppedClock, WallTime};

    use super::*;
    use crate::tests::samples;

    #[test]
    fn banner_names_the_clock_that_is_stepped() {
        let step = ClockFaultStep {
            clock: SteppedClock::Raw,
            ..ClockFaultStep::wall_step(Span::from_seconds(20), Span::from_seconds(3))
        };
        let since = WallTime::from_unix_nanos(0);
        let faults = ClockFaults { offset: Span::from_seconds(1), drift_ppm: 0.0, steps: vec![step], since };
        let mut host = samples::host("edge", "robot");
        host.clock.faults = Some(faults);
        let banner = FaultyClocks::of(&samples::snapshot(vec![host], Vec::new())).banner();
        let words = "(offset +1000 ms, step of the free-running clock +3000 ms after 20 s)";
        assert!(banner.len() == 1 && banner[0].contains(words), "{banner:?}");
    }
}
