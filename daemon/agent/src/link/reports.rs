//! What is reported of steps, jumps and doubts, and how often. No I/O.

use peernet_clock::{Doubt, ProvenSkew, RawTime, Span};

/// Suspected jumps are reported at most once in such a time: a route that flaps makes one after the other.
const JUMP_REPORT_INTERVAL: Span = Span::from_seconds(60);

/// Decides what is reported of a restart of the relation, and of doubts about its assumptions.
#[derive(Debug, Default)]
pub(super) struct RestartReports {
    /// Whose clock is known to have been stepped since the last restart: the edge's, the cloud's.
    stepped: (bool, bool),
    /// The last restart was reported as a doubt.
    is_in_doubt: bool,
    /// It was reported that the exchanges prove a skew beyond the limit.
    is_skew_told: bool,
    /// When a suspected jump was reported last, and how many were not since.
    jump_told: Option<RawTime>,
    jumps_untold: u32,
}

impl RestartReports {
    /// Notes whose clock was stepped. A step without a restart counts only while another one waits for its report.
    pub(super) const fn note_steps(&mut self, restarted: bool, (edge, cloud): (bool, bool)) {
        let counts = restarted || self.stepped.0 || self.stepped.1;
        self.stepped.0 |= counts && edge;
        self.stepped.1 |= counts && cloud;
    }

    /// Returns the report of a restart that moved the offset by `moved`; `doubt` is the assumption that the clocks seem not to
    /// keep, with its limit.
    pub(super) fn restarted(&mut self, moved: Option<Span>, doubt: Option<(Doubt, f64)>) -> Option<Restart> {
        let (edge, cloud) = std::mem::take(&mut self.stepped);
        // Clocks beyond the limit begin anew several times a second: that is reported once, until they keep it again.
        let was_in_doubt = std::mem::replace(&mut self.is_in_doubt, doubt.is_some());
        (doubt.is_none() || !was_in_doubt).then_some(Restart { moved, edge, cloud, doubt })
    }

    /// Returns the report of a jump that is suspected at a time, unless there was one shortly before.
    pub(super) fn jumped(&mut self, moved: Span, at: RawTime) -> Option<SuspectedJump> {
        if self.jump_told.is_some_and(|told| (at - told).abs() < JUMP_REPORT_INTERVAL) {
            self.jumps_untold = self.jumps_untold.saturating_add(1);
            return None;
        }
        self.jump_told = Some(at);
        Some(SuspectedJump { moved, untold: std::mem::take(&mut self.jumps_untold) })
    }

    /// Returns the report of a skew that is proven to be beyond the limit, once until it no longer is.
    pub(super) fn proven(&mut self, excess: Option<ExcessSkew>) -> Option<ExcessSkew> {
        let was_told = std::mem::replace(&mut self.is_skew_told, excess.is_some());
        excess.filter(|_| !was_told)
    }
}

/// The offset jumped, and no host noticed a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SuspectedJump {
    /// By how much.
    pub(super) moved: Span,
    /// How many were suspected since the last report, without one of their own.
    pub(super) untold: u32,
}

/// The exchanges prove a skew beyond the limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ExcessSkew {
    /// The skew that is proven.
    pub(super) proven: ProvenSkew,
    /// The limit, parts per million.
    pub(super) limit_ppm: f64,
}

/// A clock was stepped: the relation began anew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Restart {
    /// By how much the offset moved, where that is known.
    pub(super) moved: Option<Span>,
    /// Whether it was the edge's clock, as far as known.
    pub(super) edge: bool,
    /// Whether it was the cloud's.
    pub(super) cloud: bool,
    /// The assumption, with its limit in parts per million or parts per million per second, where it is more likely that the clocks do not
    /// keep it.
    pub(super) doubt: Option<(Doubt, f64)>,
}
