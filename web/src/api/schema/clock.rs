//! Schema of hosts' wall clocks.

use peernet_clock::{ClockFaults, Discipline, Interval};
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

use super::time;

/// An interval that contains the truth, seconds.
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

/// One host's wall clock, by its own account.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HostClock {
    /// Claim of its time daemon, or of the kernel; null when it is not synchronised or nothing is reported.
    pub discipline: Option<Claim>,
    /// Synchronisation in words: `chrony, stratum 2, to 10.0.0.1`, `not synchronised`.
    pub text: String,
    /// Number of times that the clock was found stepped, drifting too fast or suspended since the agent started.
    pub epoch: u32,
    /// Clock fault injected on purpose; null without one.
    #[serde(rename = "rehearsal")]
    pub clock_fault: Option<ClockFault>,
    /// Clock source of the kernel, such as `tsc`; null where it is not reported. With any other than `tsc` and `arch_sys_counter` the
    /// hypervisor supplies the clock.
    pub clocksource: Option<String>,
}

/// A claim about a wall clock: its reading minus true time lies within an interval.
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
    /// Reading of the true clock at the start.
    pub since: String,
}

/// A step of a clock fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ClockFaultStep {
    /// Time since the start, seconds.
    pub at_s: f64,
    /// Size of the step, seconds.
    pub by_s: f64,
}

impl From<&ClockFaults> for ClockFault {
    fn from(clock_fault: &ClockFaults) -> Self {
        let steps = clock_fault.steps.iter();
        Self {
            offset_s: clock_fault.offset.seconds(),
            drift_ppm: clock_fault.drift_ppm,
            steps: steps
                .map(|step| ClockFaultStep { at_s: step.at.seconds(), by_s: step.by.seconds() })
                .collect(),
            since: time(clock_fault.since),
        }
    }
}

impl From<&stream::HostClock> for HostClock {
    fn from(clock: &stream::HostClock) -> Self {
        let claim = |discipline: Discipline| Claim {
            source: discipline.source.name(),
            error: discipline.error.into(),
        };
        Self {
            discipline: clock.discipline.map(claim),
            text: clock.text.clone(),
            epoch: clock.epoch,
            clock_fault: clock.faults.as_ref().map(ClockFault::from),
            clocksource: clock.clocksource.clone(),
        }
    }
}
