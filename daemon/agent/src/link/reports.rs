//! Decides which steps, jumps, violated assumptions and lost proofs of a common clock are reported, and how often. No
//! I/O.

use peernet_clock::{ProvenSkew, RawTime, Span, ViolatedLimit};

use crate::same_clock::NotProven;

/// Shortest interval between two reports of suspected jumps, and of lost proofs. An unstable route would cause many
/// reports.
const REPORT_INTERVAL: Span = Span::from_seconds(60);
/// Time after which the end of a proof's connection is reported. The connection ends with its session; if the session
/// has not ended by then, only the proof was lost.
const ENDED_PROOF_DELAY: Span = Span::from_seconds(1);

/// Decides which restarts of the relation, violated assumptions and lost proofs of a common clock are reported.
#[derive(Debug, Default)]
pub(super) struct ClockReports {
    /// Whether the edge's clock was stepped since the last restart, and whether the cloud's clock was.
    stepped_clocks: (bool, bool),
    /// `true` if the last restart was reported as a violated assumption.
    has_reported_violation: bool,
    /// `true` if the last checked skew was proven to be beyond the limit, and was therefore reported.
    is_excess_reported: bool,
    jumps: ReportLimit,
    lost_proofs: ReportLimit,
    /// Reason and time of a proof that was lost with its connection. The session may have ended, too.
    ended_proof: Option<(NotProven, RawTime)>,
}

/// Limits how often findings of one kind are reported.
#[derive(Debug, Default)]
struct ReportLimit {
    last_report: Option<RawTime>,
    /// Number of findings since the last report that were not reported.
    unreported: u32,
}

impl ReportLimit {
    /// If a report is allowed, returns the number of findings since the last report that were not reported. Otherwise
    /// counts this finding as not reported.
    fn try_report(&mut self, at: RawTime) -> Option<u32> {
        if self.last_report.is_some_and(|last| (at - last).abs() < REPORT_INTERVAL) {
            self.unreported = self.unreported.saturating_add(1);
            return None;
        }
        self.last_report = Some(at);
        Some(std::mem::take(&mut self.unreported))
    }
}

impl ClockReports {
    /// Records whose clock was stepped. A step without a restart is recorded only if another step is already recorded.
    // A step does not restart a relation without exchanges. If an earlier recorded step has removed the exchanges, both
    // steps belong to the same restart. Otherwise there is no restart to report.
    pub(super) const fn record_steps(&mut self, is_restarted: bool, (edge, cloud): (bool, bool)) {
        let is_recorded = is_restarted || self.stepped_clocks.0 || self.stepped_clocks.1;
        self.stepped_clocks.0 |= is_recorded && edge;
        self.stepped_clocks.1 |= is_recorded && cloud;
    }

    /// Returns the report of a restart that moved the offset by `movement`. `violation` is the assumption that the
    /// clocks seem to violate, with its limit.
    pub(super) fn report_restart(
        &mut self,
        movement: Option<Span>,
        violation: Option<(ViolatedLimit, f64)>,
    ) -> Option<Restart> {
        let (edge_stepped, cloud_stepped) = std::mem::take(&mut self.stepped_clocks);
        // Clocks beyond the limit cause several restarts per second. Only the first restart is reported, until the
        // clocks are within the limit again.
        let had_reported_violation = std::mem::replace(&mut self.has_reported_violation, violation.is_some());
        (violation.is_none() || !had_reported_violation).then_some(Restart {
            movement,
            edge_stepped,
            cloud_stepped,
            violation,
        })
    }

    /// Returns the report of a jump that is suspected at `at`, unless another jump was reported shortly before.
    pub(super) fn report_jump(&mut self, movement: Span, at: RawTime) -> Option<SuspectedJump> {
        let unreported = self.jumps.try_report(at)?;
        Some(SuspectedJump { movement, unreported })
    }

    /// Returns the report of a lost proof, unless another lost proof was reported shortly before. A proof that was lost
    /// with its connection is reported by [`report_ended_proof`](Self::report_ended_proof), if the session continues
    /// without the proof.
    pub(super) fn report_lost_proof(&mut self, reason: NotProven, at: RawTime) -> Option<LostProof> {
        if let NotProven::Ended(_) = reason {
            self.ended_proof = Some((reason, at));
            return None;
        }
        let unreported = self.lost_proofs.try_report(at)?;
        Some(LostProof { reason, unreported })
    }

    /// Records that the common clock is proven again.
    pub(super) fn clear_ended_proof(&mut self) {
        self.ended_proof = None;
    }

    /// Returns the report of a proof whose connection ended at least [`ENDED_PROOF_DELAY`] ago.
    pub(super) fn report_ended_proof(&mut self, now: RawTime) -> Option<LostProof> {
        let (reason, at) = self.ended_proof.take_if(|(_, at)| (now - *at).abs() >= ENDED_PROOF_DELAY)?;
        let unreported = self.lost_proofs.try_report(at)?;
        Some(LostProof { reason, unreported })
    }

    /// Returns the report of a skew that is proven to be beyond the limit: once, until the skew is within the limit
    /// again.
    pub(super) fn report_excess_skew(&mut self, excess: Option<ExcessSkew>) -> Option<ExcessSkew> {
        let was_reported = std::mem::replace(&mut self.is_excess_reported, excess.is_some());
        excess.filter(|_| !was_reported)
    }
}

/// A jump of the offset that no host noticed as a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SuspectedJump {
    /// Size of the jump.
    pub(super) movement: Span,
    /// Number of suspected jumps since the last report that were not reported.
    pub(super) unreported: u32,
}

/// Loss of the proof that both processes read one clock.
#[derive(Debug)]
pub(super) struct LostProof {
    pub(super) reason: NotProven,
    /// Number of lost proofs since the last report that were not reported.
    pub(super) unreported: u32,
}

/// Skew beyond the limit, as proven by the exchanges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ExcessSkew {
    /// Skew that is proven.
    pub(super) proven: ProvenSkew,
    /// Limit in parts per million.
    pub(super) limit_ppm: f64,
}

/// Restart of the relation because a clock was stepped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Restart {
    /// Change of the offset, if it is known.
    pub(super) movement: Option<Span>,
    /// `true` if the edge's clock is known to have been stepped.
    pub(super) edge_stepped: bool,
    /// `true` if the cloud's clock is known to have been stepped.
    pub(super) cloud_stepped: bool,
    /// Assumption that the clocks seem to violate, with its limit in parts per million or parts per million per second.
    /// `None` if a step is the more probable cause.
    pub(super) violation: Option<(ViolatedLimit, f64)>,
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    fn at(millis: i64) -> RawTime {
        RawTime::from_nanos(millis * 1_000_000)
    }

    fn connection_ended() -> NotProven {
        io::Error::from(io::ErrorKind::UnexpectedEof).into()
    }

    #[test]
    fn lost_proofs_are_reported_once_per_minute_with_count() {
        let mut reports = ClockReports::default();
        let mut unreported =
            |millis| reports.report_lost_proof(NotProven::PeerTime, at(millis)).map(|lost| lost.unreported);
        let reported = [0, 4_000, 59_999, 60_000, 70_000, 121_000].map(&mut unreported);
        assert_eq!(reported, [Some(0), None, None, Some(2), None, Some(1)]);
    }

    #[test]
    fn lost_proofs_do_not_hide_suspected_jumps() {
        let mut reports = ClockReports::default();
        assert!(reports.report_lost_proof(NotProven::OwnTime, at(0)).is_some());
        assert!(reports.report_jump(Span::from_millis(39), at(1)).is_some());
    }

    #[test]
    fn ended_proof_is_reported_unless_proven_again() {
        let mut reports = ClockReports::default();
        assert!(reports.report_lost_proof(connection_ended(), at(0)).is_none());
        assert!(reports.report_ended_proof(at(999)).is_none(), "the session may still end");
        let lost = reports.report_ended_proof(at(1_000)).expect("the session continues");
        assert!(matches!(lost, LostProof { reason: NotProven::Ended(_), unreported: 0 }), "{lost:?}");
        assert!(reports.report_ended_proof(at(2_000)).is_none(), "the lost proof is reported once");

        assert!(reports.report_lost_proof(connection_ended(), at(100_000)).is_none());
        reports.clear_ended_proof();
        assert!(
            reports.report_ended_proof(at(102_000)).is_none(),
            "another session of the link has proven the common clock"
        );
    }
}
