//! Injected clock faults. Every page that shows such a clock, or numbers that depend on it, names the fault.

use std::collections::BTreeMap;

use peernet_aggregator::LiveState;
use peernet_clock::ClockFaults;
use peernet_statistics::number::{SPACE, fixed};

use super::chip::{Chip, Tone};

/// Chip of a host with an injected clock fault, and of its measurements.
pub(crate) const CHIP: Chip = Chip::new(Tone::Warn, "clock-fault", "clock fault");

/// Formats a number, with a plus sign if it is positive.
fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if value > 0.0 { format!("+{text}") } else { text }
}

/// Formats a drift in ppm, with one decimal unless the drift is a whole number.
fn ppm(value: f64) -> String {
    signed(value, usize::from(value.fract() != 0.0))
}

/// Returns the clock fault in words: `+1,000 ms, +50 ppm`.
pub(crate) fn describe(faults: &ClockFaults) -> String {
    let offset = faults.offset.seconds() * 1e3;
    let mut parts = vec![
        format!("{}{SPACE}ms", signed(offset, if offset.fract() == 0.0 { 0 } else { 2 })),
        format!("{}{SPACE}ppm", ppm(faults.drift_ppm)),
    ];
    match faults.steps.as_slice() {
        [] => {}
        [step] => parts.push(format!(
            "a step of {}{SPACE}ms after {}",
            signed(step.by.seconds() * 1e3, 0),
            peernet_statistics::number::length(step.at.seconds())
        )),
        steps => parts.push(format!("{} steps", steps.len())),
    }
    parts.join(", ")
}

/// Hosts with an injected clock fault, by name, with the fault in words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FaultyClocks(BTreeMap<String, String>);

impl FaultyClocks {
    /// Collects the clock faults of the hosts in the live state.
    pub(crate) fn of(snapshot: &LiveState) -> Self {
        let connected = snapshot.hosts.iter().filter(|host| host.connected);
        let own_faults = connected.filter_map(|host| {
            Some((host.description.name.to_string(), describe(host.clock.faults.as_ref()?)))
        });
        // A cloud may report to another aggregator. In that case, only its edges report the fault of its clock to this
        // aggregator.
        let links = snapshot.links.iter().filter(|link| link.connected);
        let faults_reported_by_edges = links.filter_map(|link| {
            Some((link.live.peer_name.to_string(), describe(link.live.cloud.as_ref()?.faults.as_ref()?)))
        });
        // Of two reports about one host, the later in this order is kept: the host's own.
        Self(faults_reported_by_edges.chain(own_faults).collect())
    }

    /// Returns the sentences of the banner on every page, one per host.
    pub(crate) fn banner(&self) -> Vec<String> {
        let sentence = |(name, fault): (&String, &String)| {
            format!(
                "Clock fault injection: {name}'s clock is made wrong on purpose ({fault}). Its measured delays should stay the same."
            )
        };
        self.0.iter().map(sentence).collect()
    }

    /// Returns whether a host of one of these names has a clock fault.
    pub(crate) fn concerns(&self, names: &[&str]) -> bool {
        names.iter().any(|name| self.0.contains_key(*name))
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockFaultStep, Span, WallTime};

    use super::*;

    fn clock_fault(offset: Span, drift_ppm: f64, steps: Vec<ClockFaultStep>) -> ClockFaults {
        ClockFaults { offset, drift_ppm, steps, since: WallTime::from_unix_nanos(0) }
    }

    #[test]
    fn clock_fault_is_described_with_signs() {
        let plain = clock_fault(Span::from_seconds(1), 50.0, Vec::new());
        assert_eq!(describe(&plain), "+1,000\u{202f}ms, +50\u{202f}ppm");
        let step = ClockFaultStep::wall_step(Span::from_seconds(60), Span::from_seconds(3));
        let stepped = clock_fault(Span::from_micros(-1_500), -12.5, vec![step]);
        assert_eq!(
            describe(&stepped),
            "\u{2212}1.50\u{202f}ms, \u{2212}12.5\u{202f}ppm, a step of +3,000\u{202f}ms after 1\u{202f}min"
        );
    }
}
