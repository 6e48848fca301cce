//! Description of the faults that are injected into the clocks of a host.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{RawTime, Span, WallTime};

/// Faults of the wall clock and the free-running clock. A clock shows `true + offset + drift × (true − since) + sum of
/// the steps of this clock so far`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockFaults {
    /// Offset of both clocks at the start of the faults.
    pub offset: Span,
    /// Drift in parts per million; positive if the clock is fast.
    pub drift_ppm: f64,
    /// Steps, in any order.
    pub steps: Vec<ClockFaultStep>,
    /// True wall-clock time at which the faults start. Drift and steps are counted from this time.
    pub since: WallTime,
}

/// A step of a clock with injected faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockFaultStep {
    /// Time from the start of the faults to the step.
    pub at: Span,
    /// Size of the step.
    pub by: Span,
    /// Clock that is stepped.
    // The serialised form omits the wall clock, so that earlier releases, which step no other clock, can read it.
    #[serde(default, skip_serializing_if = "SteppedClock::is_wall")]
    pub clock: SteppedClock,
}

impl ClockFaultStep {
    /// Creates a step of the wall clock.
    pub const fn wall_step(at: Span, by: Span) -> Self {
        Self { at, by, clock: SteppedClock::Wall }
    }
}

/// Clock that an injected step applies to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SteppedClock {
    /// The wall clock, as when an administrator sets it. The host detects the step at once.
    #[default]
    Wall,
    /// The free-running clock, as when a virtual machine is paused. The host cannot detect the step.
    Raw,
}

impl SteppedClock {
    /// Returns whether the stepped clock is the wall clock.
    pub fn is_wall(&self) -> bool {
        *self == Self::Wall
    }
}

/// Formats the faults, such as `offset +1000 ms, drift -50 ppm, step +3000 ms after 20 s`.
impl fmt::Display for ClockFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let millis = |span: Span| span.nanos() as f64 / 1e6;
        write!(f, "offset {:+} ms", millis(self.offset))?;
        if self.drift_ppm != 0.0 {
            write!(f, ", drift {:+} ppm", self.drift_ppm)?;
        }
        for step in &self.steps {
            let clock = if step.clock.is_wall() { "" } else { " of the free-running clock" };
            write!(f, ", step{clock} {:+} ms after {} s", millis(step.by), step.at.seconds())?;
        }
        Ok(())
    }
}

impl ClockFaults {
    /// Returns the time that the wall clock shows when the true wall clock shows `truth`.
    pub fn shown_wall(&self, truth: WallTime) -> WallTime {
        truth + self.wall_error_at(truth)
    }

    /// Returns the error of the wall clock (shown minus true) when the true wall clock shows `truth`.
    pub fn wall_error_at(&self, truth: WallTime) -> Span {
        self.error_after(truth - self.since, SteppedClock::Wall)
    }

    /// Returns the time that the free-running clock shows when the true free-running clock shows `truth`. `since` is
    /// the time that the true clock showed at the start.
    pub fn shown_raw(&self, truth: RawTime, since: RawTime) -> RawTime {
        truth + self.error_after(truth - since, SteppedClock::Raw)
    }

    /// Returns the true wall-clock time at which this clock showed `shown_wall`, to the nanosecond.
    ///
    /// A clock that was set back shows some times twice; the result is then the later of the two true times. A clock
    /// that was set forward skips some times; the result is then the time of the step.
    pub fn true_wall(&self, shown_wall: WallTime) -> WallTime {
        let steps = self.steps.iter().filter(|step| step.clock.is_wall());
        // A step starts a period without further steps. Before the first step there is one more such period.
        let mut starts: Vec<WallTime> = steps.map(|step| self.since + step.at).collect();
        starts.push(WallTime::from_unix_nanos(i64::MIN));
        // The loop goes from the last step to the first, because the last matching time is the result.
        starts.sort_unstable_by(|a, b| b.cmp(a));
        let mut end = WallTime::from_unix_nanos(i64::MAX);
        for start in starts {
            let steps_so_far: Span =
                self.steps_within(start - self.since, SteppedClock::Wall).map(|step| step.by).sum();
            let truth = self.true_wall_without_steps(shown_wall - steps_so_far);
            if truth >= start {
                return truth.min(end);
            }
            end = start;
        }
        end
    }

    /// Returns the error of a clock (shown minus true) at a time after the start.
    fn error_after(&self, elapsed: Span, clock: SteppedClock) -> Span {
        let drift = elapsed.nanos() as f64 * self.drift_ppm * 1e-6;
        let steps: Span = self.steps_within(elapsed, clock).map(|step| step.by).sum();
        self.offset + Span::from_nanos(drift.round() as i64) + steps
    }

    /// Returns the true time at which the clock would have shown `shown_wall` if it had no steps.
    fn true_wall_without_steps(&self, shown_wall: WallTime) -> WallTime {
        let without_offset = shown_wall - self.offset;
        let elapsed = (without_offset - self.since).nanos() as f64;
        // The shown elapsed time is the true elapsed time × (1 + drift). Only the shown time is known, so the
        // shown time is divided.
        let drift = elapsed - elapsed / (1.0 + self.drift_ppm * 1e-6);
        without_offset - Span::from_nanos(drift.round() as i64)
    }

    /// Returns the steps of a clock up to a time after the start.
    pub(crate) fn steps_within(
        &self,
        elapsed: Span,
        clock: SteppedClock,
    ) -> impl Iterator<Item = &ClockFaultStep> {
        self.steps.iter().filter(move |step| step.clock == clock && step.at <= elapsed)
    }
}
