//! Schema of hosts' wall clocks.

use peernet_clock::{ClockClaim, ClockFaults, Interval};
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

use super::time;

/// An interval that contains the true value, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Bounds {
    pub lo_s: f64,
    pub hi_s: f64,
}

impl From<Interval> for Bounds {
    fn from(interval: Interval) -> Self {
        Self { lo_s: interval.lo.seconds(), hi_s: interval.hi.seconds() }
    }
}

/// A host's wall clock, as its agent reports it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HostClock {
    /// Claim of the time daemon or of the kernel; null if the clock is not synchronised or nothing is reported.
    #[serde(rename = "discipline")]
    pub claim: Option<Claim>,
    /// Description of the synchronisation: `chrony, stratum 2, to 10.0.0.1`, `not synchronised`.
    pub text: String,
    /// Number of steps, excessive drifts and suspensions of the clock that were detected since the agent started.
    pub epoch: u32,
    /// Clock fault injected on purpose, as last reported; null without one.
    #[serde(rename = "rehearsal")]
    pub clock_fault: Option<ClockFault>,
    /// Clock source of the kernel, such as `tsc`; null if not reported. In a virtual machine, any source other than
    /// `tsc` and `arch_sys_counter` means that the hypervisor supplies the clock.
    pub clocksource: Option<String>,
}

/// A claim that the reading of a wall clock minus true time lies within an interval.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Claim {
    /// `kernel` or `chrony`.
    pub source: &'static str,
    pub error: Bounds,
}

/// Clock fault injected on purpose.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ClockFault {
    /// Offset at the start, seconds; positive if the clock is ahead.
    pub offset_s: f64,
    /// Drift, parts per million; positive if the clock runs fast.
    pub drift_ppm: f64,
    pub steps: Vec<ClockFaultStep>,
    /// Time of the start, by the clock without the fault.
    pub since: String,
}

/// A step of a clock fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ClockFaultStep {
    /// Time since the start, seconds.
    pub at_s: f64,
    /// Size of the step, seconds; positive if the clock is set forward.
    pub by_s: f64,
    /// Clock that is stepped: `wall`, or `raw` for the free-running clock.
    pub clock: &'static str,
}

impl From<&ClockFaults> for ClockFault {
    fn from(clock_fault: &ClockFaults) -> Self {
        let steps = clock_fault.steps.iter();
        Self {
            offset_s: clock_fault.offset.seconds(),
            drift_ppm: clock_fault.drift_ppm,
            steps: steps
                .map(|step| ClockFaultStep {
                    at_s: step.at.seconds(),
                    by_s: step.by.seconds(),
                    clock: if step.clock.is_wall() { "wall" } else { "raw" },
                })
                .collect(),
            since: time(clock_fault.since),
        }
    }
}

impl From<&stream::HostClock> for HostClock {
    fn from(clock: &stream::HostClock) -> Self {
        let claim = |claim: ClockClaim| Claim { source: claim.source.name(), error: claim.error.into() };
        Self {
            claim: clock.claim.map(claim),
            text: clock.text.clone(),
            epoch: clock.epoch,
            clock_fault: clock.faults.as_ref().map(ClockFault::from),
            clocksource: clock.clocksource.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Span, SteppedClock, WallTime};

    use super::*;

    #[test]
    fn step_of_clock_fault_names_its_clock() {
        let wall = peernet_clock::ClockFaultStep::wall_step(Span::from_seconds(9), Span::from_seconds(3));
        let raw = peernet_clock::ClockFaultStep { clock: SteppedClock::Raw, ..wall };
        let since = WallTime::from_unix_nanos(0);
        let faults = ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps: vec![wall, raw], since };
        let clock_fault = ClockFault::from(&faults);
        assert_eq!(clock_fault.steps.iter().map(|step| step.clock).collect::<Vec<_>>(), ["wall", "raw"]);
    }
}
