//! What is reported of steps, jumps, lost proofs and doubts, and how often. No I/O.

use peernet_clock::{Doubt, ProvenSkew, RawTime, Span};

use crate::same_clock::NotProven;

/// Suspected jumps are reported at most once in such a time, and so are lost proofs: a route that flaps makes one after the other.
const REPORT_INTERVAL: Span = Span::from_seconds(60);
/// A connection that proved one clock ends with its session. If the session has not ended after such a time the proof alone is lost.
const SESSION_END: Span = Span::from_seconds(1);

/// Decides what is reported of a restart of the relation, of doubts about its assumptions, and of lost proofs of one clock.
#[derive(Debug, Default)]
pub(super) struct ClockReports {
    /// Whose clock is known to have been stepped since the last restart: the edge's, the cloud's.
    stepped: (bool, bool),
    /// The last restart was reported as a doubt.
    is_in_doubt: bool,
    /// It was reported that the exchanges prove a skew beyond the limit.
    is_skew_told: bool,
    jumps: ReportLimit,
    lost_proofs: ReportLimit,
    /// The proof that was lost with its connection, and when: the session may be over, too.
    ended_proof: Option<(NotProven, RawTime)>,
}

/// Limits how often events of one kind are reported.
#[derive(Debug, Default)]
struct ReportLimit {
    last_report: Option<RawTime>,
    /// Events since the last report.
    untold: u32,
}

impl ReportLimit {
    /// Returns how many events were not reported since the last report, if that is long enough ago; else counts this one.
    fn untold_before(&mut self, at: RawTime) -> Option<u32> {
        if self.last_report.is_some_and(|last| (at - last).abs() < REPORT_INTERVAL) {
            self.untold = self.untold.saturating_add(1);
            return None;
        }
        self.last_report = Some(at);
        Some(std::mem::take(&mut self.untold))
    }
}

impl ClockReports {
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
        let untold = self.jumps.untold_before(at)?;
        Some(SuspectedJump { moved, untold })
    }

    /// Returns the report of a proof of one clock that was lost, unless there was one shortly before. A proof that was lost with
    /// its connection is reported by [`second_over`](Self::second_over), if the session goes on without it.
    pub(super) fn proof_lost(&mut self, why: NotProven, at: RawTime) -> Option<LostProof> {
        if let NotProven::Ended(_) = why {
            self.ended_proof = Some((why, at));
            return None;
        }
        let untold = self.lost_proofs.untold_before(at)?;
        Some(LostProof { why, untold })
    }

    /// One clock is proven again.
    pub(super) fn proof_regained(&mut self) {
        self.ended_proof = None;
    }

    /// Returns the report of a proof whose connection ended some time ago.
    pub(super) fn second_over(&mut self, now: RawTime) -> Option<LostProof> {
        let (why, at) = self.ended_proof.take_if(|(_, at)| (now - *at).abs() >= SESSION_END)?;
        let untold = self.lost_proofs.untold_before(at)?;
        Some(LostProof { why, untold })
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

/// It is no longer proven that both processes read one clock.
#[derive(Debug)]
pub(super) struct LostProof {
    pub(super) why: NotProven,
    /// How many proofs were lost since the last report, without one of their own.
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

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    fn at(millis: i64) -> RawTime {
        RawTime::from_nanos(millis * 1_000_000)
    }

    fn ended() -> NotProven {
        io::Error::from(io::ErrorKind::UnexpectedEof).into()
    }

    #[test]
    fn lost_proofs_are_reported_once_a_minute_with_their_number() {
        let mut reports = ClockReports::default();
        let mut untold = |millis| reports.proof_lost(NotProven::PeerTime, at(millis)).map(|lost| lost.untold);
        let told = [0, 4_000, 59_999, 60_000, 70_000, 121_000].map(&mut untold);
        assert_eq!(told, [Some(0), None, None, Some(2), None, Some(1)]);
    }

    #[test]
    fn lost_proofs_do_not_hide_suspected_jumps() {
        let mut reports = ClockReports::default();
        assert!(reports.proof_lost(NotProven::OwnTime, at(0)).is_some());
        assert!(reports.jumped(Span::from_millis(39), at(1)).is_some());
    }

    #[test]
    fn proof_that_ends_with_its_session_is_not_reported() {
        let mut reports = ClockReports::default();
        assert!(reports.proof_lost(ended(), at(0)).is_none());
        assert!(reports.second_over(at(999)).is_none(), "the session may still end");
        let lost = reports.second_over(at(1_000)).expect("the session goes on");
        assert!(matches!(lost, LostProof { why: NotProven::Ended(_), untold: 0 }), "{lost:?}");
        assert!(reports.second_over(at(2_000)).is_none(), "it is reported once");

        assert!(reports.proof_lost(ended(), at(100_000)).is_none());
        reports.proof_regained();
        assert!(reports.second_over(at(102_000)).is_none(), "another session of the link proves it");
    }
}
