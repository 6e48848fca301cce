//! Decides whether the probes of a link are shown as answered, and why not. No I/O.

use peernet_clock::{LogThrottle, MonoTime};
use peernet_logger::Slug;
use peernet_probes::ProbeResult;
use peernet_probes::stamp::sender::{
    ALTERED_PROBE_TLVS, ALTERED_REPLY_TLVS, NO_ORIGIN, NOT_PEERNET, WRONG_PROCESS,
};
use peernet_stream::Probing;

/// Number of probes lost in a row after which they count as not answered.
const UNANSWERED_AFTER: u32 = 3;

/// Reason that is shown when answers come too late.
const LATE_ANSWERS: &str = "answers arrive more than 2 s after their probes, which count as lost";

/// Decides from the results of the probes to one reflector whether they are shown as answered.
#[derive(Debug)]
pub(super) struct Answers {
    /// Name of the cloud, for the log.
    peer: Slug,
    /// `true` if this end has a configured key.
    keyed: bool,
    /// Number of probes that were sent and are neither answered nor lost.
    under_way: u32,
    /// Number of probes lost in a row.
    lost: u32,
    /// Shown state from before the answers stopped.
    before: Option<Probing>,
    /// Reason of the latest refusal since the last accepted answer.
    refused: Option<&'static str>,
    /// Number of refusals since the last accepted answer.
    refusals: u32,
    /// Number of answers that came too late since the last accepted one.
    late: u32,
    /// Limits log lines, so that a sender of garbage cannot fill the log.
    log: LogThrottle,
}

impl Answers {
    /// Creates the state for a reflector that has not been probed.
    pub(super) fn new(peer: Slug, keyed: bool) -> Self {
        let log = LogThrottle::default();
        Self { peer, keyed, under_way: 0, lost: 0, before: None, refused: None, refusals: 0, late: 0, log }
    }

    /// Returns the number of probes that were sent and are neither answered nor lost.
    pub(super) const fn under_way(&self) -> u32 {
        self.under_way
    }

    /// Handles the result of a probe, and updates the shown state.
    pub(super) fn note(&mut self, result: &ProbeResult, now: MonoTime, shown: &mut Probing) {
        match result {
            ProbeResult::Sent => self.under_way = self.under_way.saturating_add(1),
            ProbeResult::Lost => {
                self.under_way = self.under_way.saturating_sub(1);
                self.lost = self.lost.saturating_add(1);
                if self.lost >= UNANSWERED_AFTER
                    && let Probing::On { address, .. } = &*shown
                {
                    let unanswered = self.unanswered(address.clone());
                    self.before = Some(std::mem::replace(shown, unanswered));
                }
            }
            ProbeResult::Answered(_) | ProbeResult::Stepped(_) => {
                self.under_way = self.under_way.saturating_sub(1);
                (self.lost, self.refused, self.refusals, self.late) = (0, None, 0, 0);
                if let Some(on) = self.before.take() {
                    *shown = on;
                }
            }
            ProbeResult::Refused(why) => {
                self.refusals = self.refusals.saturating_add(1);
                self.refused = Some(why);
                if let Some(times) = self.log.count(why, None, now) {
                    tracing::warn!(
                        peer = %self.peer, times,
                        "probes fail: {why} (logged at most once a minute, with the number since the last line)"
                    );
                }
                if let Probing::Unanswered { address, .. } = &*shown {
                    *shown = self.unanswered(address.clone());
                }
            }
            ProbeResult::Late => {
                self.late = self.late.saturating_add(1);
                if let Probing::Unanswered { address, .. } = &*shown {
                    *shown = self.unanswered(address.clone());
                }
            }
            ProbeResult::Refined(_) => {}
        }
    }

    fn unanswered(&self, address: String) -> Probing {
        let reason = why_unanswered(self.keyed, self.refused);
        if self.refused.is_none() && self.late > 0 {
            let reason = Some(format!("{LATE_ANSWERS} ({} late)", self.late));
            return Probing::Unanswered { address, reason };
        }
        let counted = |reason| match self.refusals {
            0 => reason,
            refusals => format!("{reason} ({refusals} refused)"),
        };
        Probing::Unanswered { address, reason: reason.map(counted) }
    }
}

/// Returns the probable reason why probes are not answered, as far as this end can know: whether it has a key, and
/// which answers were refused. `None` if it may be a blocked port.
fn why_unanswered(key: bool, refused: Option<&str>) -> Option<String> {
    match (key, refused) {
        // These answers are authentic if there is a key.
        (_, Some(why @ (WRONG_PROCESS | NOT_PEERNET))) => Some(format!(
            "{why}; the data's address must lead to one machine, for UDP too: see forwarded ports and load balancers"
        )),
        (_, Some(why @ (ALTERED_REPLY_TLVS | ALTERED_PROBE_TLVS | NO_ORIGIN))) => {
            Some(format!("what comes back is {why}"))
        }
        (false, None) => None,
        (true, None) => Some("no answer; with [probes] key_file both ends need the same key".to_owned()),
        (true, Some(why)) => Some(format!(
            "what comes back is {why}; with [probes] key_file both ends need the same key, and the other one seems to \
             have none or another"
        )),
        (false, Some(why)) => Some(format!("what comes back is refused: {why}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_answers_are_named_as_reason_and_not_refused() {
        let mut answers = Answers::new("cloud".parse().expect("a name"), true);
        let address = "udp://10.0.0.3:862".to_owned();
        let mut shown = Probing::On { address, rate_hz: 10.0, stamps: "kernel".into() };
        let now = MonoTime::from_nanos(0);
        for _ in 0..UNANSWERED_AFTER {
            answers.note(&ProbeResult::Sent, now, &mut shown);
            answers.note(&ProbeResult::Lost, now, &mut shown);
        }
        answers.note(&ProbeResult::Late, now, &mut shown);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown else { panic!("{shown:?}") };
        assert!(reason.contains("(1 late)") && !reason.contains("refused"), "{reason}");
        answers.note(&ProbeResult::Refused(NOT_PEERNET), now, &mut shown);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown else { panic!("{shown:?}") };
        assert!(reason.contains(NOT_PEERNET), "{reason}");
    }

    #[test]
    fn key_is_named_where_it_may_be_the_reason() {
        assert_eq!(why_unanswered(false, None), None);
        for refused in [None, Some("not authenticated by the key"), Some("shorter than a reply")] {
            let reason = why_unanswered(true, refused).expect("something is known");
            assert!(reason.contains("both ends need the same key"), "{reason}");
            assert!(refused.is_none_or(|refused| reason.contains(refused)), "{reason}");
        }
        for another in [WRONG_PROCESS, NOT_PEERNET, ALTERED_REPLY_TLVS, ALTERED_PROBE_TLVS, NO_ORIGIN] {
            let reason = why_unanswered(true, Some(another)).expect("something is known");
            assert!(reason.contains(another) && !reason.contains("key"), "{reason}");
        }
        assert!(
            why_unanswered(false, Some("not from the target")).is_some_and(|reason| !reason.contains("key"))
        );
    }
}
