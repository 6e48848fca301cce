//! Decides whether the probes of a link are shown as answered, and determines the shown reason if they are not. No I/O.

use peernet_clock::{LogThrottle, MonoTime};
use peernet_logger::Slug;
use peernet_probes::ProbeResult;
use peernet_probes::stamp::sender::{
    ALTERED_PROBE_TLVS, ALTERED_REPLY_TLVS, NO_ORIGIN, NOT_PEERNET, WRONG_PROCESS,
};
use peernet_stream::Probing;

/// Number of consecutive lost probes after which probes are shown as unanswered.
const UNANSWERED_AFTER: u32 = 3;

/// Reason that is shown when answers come too late.
const LATE_ANSWERS: &str = "answers arrive more than 2 s after their probes, so the probes count as lost";

/// Decides from the results of the probes to one reflector whether the probes are shown as answered.
#[derive(Debug)]
pub(super) struct AnswerMonitor {
    /// Name of the cloud, for the log.
    peer: Slug,
    /// `true` if this end has a configured key.
    has_key: bool,
    /// Number of probes that were sent and are neither answered nor lost.
    in_flight: u32,
    /// Number of consecutive lost probes.
    consecutive_losses: u32,
    /// Shown state from the time before the answers stopped.
    answered_state: Option<Probing>,
    /// Reason of the latest refusal since the last accepted answer.
    refusal_reason: Option<&'static str>,
    /// Number of refusals since the last accepted answer.
    refusals: u32,
    /// Number of answers that came too late since the last accepted answer.
    late_answers: u32,
    /// Limits log lines, so that a sender of invalid packets cannot fill the log.
    log: LogThrottle,
}

impl AnswerMonitor {
    /// Creates the state for a reflector that has not been probed.
    pub(super) fn new(peer: Slug, has_key: bool) -> Self {
        let log = LogThrottle::default();
        Self {
            peer,
            has_key,
            in_flight: 0,
            consecutive_losses: 0,
            answered_state: None,
            refusal_reason: None,
            refusals: 0,
            late_answers: 0,
            log,
        }
    }

    /// Returns the number of probes that were sent and are neither answered nor lost.
    pub(super) const fn in_flight(&self) -> u32 {
        self.in_flight
    }

    /// Handles the result of a probe, and updates the shown state.
    pub(super) fn record(&mut self, result: &ProbeResult, now: MonoTime, shown_state: &mut Probing) {
        match result {
            ProbeResult::Sent => self.in_flight = self.in_flight.saturating_add(1),
            ProbeResult::Lost => {
                self.in_flight = self.in_flight.saturating_sub(1);
                self.consecutive_losses = self.consecutive_losses.saturating_add(1);
                if self.consecutive_losses >= UNANSWERED_AFTER
                    && let Probing::On { address, .. } = &*shown_state
                {
                    let unanswered_state = self.unanswered_state(address.clone());
                    self.answered_state = Some(std::mem::replace(shown_state, unanswered_state));
                }
            }
            ProbeResult::Answered(_) | ProbeResult::ClockInterrupted(_) => {
                self.in_flight = self.in_flight.saturating_sub(1);
                (self.consecutive_losses, self.refusal_reason, self.refusals, self.late_answers) =
                    (0, None, 0, 0);
                if let Some(answered_state) = self.answered_state.take() {
                    *shown_state = answered_state;
                }
            }
            ProbeResult::Refused(reason) => {
                // The probe stays in flight until it is answered or lost: a refused packet may be forged.
                self.refusals = self.refusals.saturating_add(1);
                self.refusal_reason = Some(reason);
                // Lines about all senders of one reason are limited together.
                let sender_address = None;
                if let Some(times) = self.log.count_event(reason, sender_address, now) {
                    tracing::warn!(
                        peer = %self.peer, times,
                        "a reply to a probe was refused: {reason} (logged at most once a minute, with the count)"
                    );
                }
                if let Probing::Unanswered { address, .. } = &*shown_state {
                    *shown_state = self.unanswered_state(address.clone());
                }
            }
            ProbeResult::Late => {
                self.late_answers = self.late_answers.saturating_add(1);
                if let Probing::Unanswered { address, .. } = &*shown_state {
                    *shown_state = self.unanswered_state(address.clone());
                }
            }
            ProbeResult::Refined(_) => {}
        }
    }

    /// Returns the state that is shown while probes are not answered, with the probable reason.
    fn unanswered_state(&self, address: String) -> Probing {
        let reason = unanswered_reason(self.has_key, self.refusal_reason);
        if self.refusal_reason.is_none() && self.late_answers > 0 {
            let reason = Some(format!("{LATE_ANSWERS} ({} late)", self.late_answers));
            return Probing::Unanswered { address, reason };
        }
        let with_count = |reason| match self.refusals {
            0 => reason,
            refusals => format!("{reason} ({refusals} refused)"),
        };
        Probing::Unanswered { address, reason: reason.map(with_count) }
    }
}

/// Returns the probable reason why probes are not answered, from `has_key` (this end has a configured key) and the
/// latest refusal. `None` if there is no sign of a reason; the port may be blocked.
fn unanswered_reason(has_key: bool, refusal_reason: Option<&str>) -> Option<String> {
    match (has_key, refusal_reason) {
        // If there is a key, an answer with these faults was authenticated by it. The key is therefore not the reason.
        (_, Some(reason @ (WRONG_PROCESS | NOT_PEERNET))) => Some(format!(
            "{reason}; probes to the address of the session must reach the same machine over UDP: check forwarded ports and load balancers"
        )),
        (_, Some(reason @ (ALTERED_REPLY_TLVS | ALTERED_PROBE_TLVS | NO_ORIGIN))) => {
            Some(format!("the replies are {reason}"))
        }
        (false, None) => None,
        (true, None) => Some("no answer; with [probes] key_file both ends need the same key".to_owned()),
        (true, Some(reason)) => Some(format!(
            "the replies are {reason}; with [probes] key_file both ends need the same key, and the other end seems to have no \
             key or another key"
        )),
        (false, Some(reason)) => Some(format!("the replies are refused: {reason}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_answers_are_reason_unless_reply_is_refused() {
        let has_key = true;
        let mut monitor = AnswerMonitor::new("cloud".parse().expect("a name"), has_key);
        let address = "udp://10.0.0.3:862".to_owned();
        let mut shown_state = Probing::On { address, rate_hz: 10.0, stamps: "kernel".into() };
        let now = MonoTime::from_nanos(0);
        for _ in 0..UNANSWERED_AFTER {
            monitor.record(&ProbeResult::Sent, now, &mut shown_state);
            monitor.record(&ProbeResult::Lost, now, &mut shown_state);
        }
        monitor.record(&ProbeResult::Late, now, &mut shown_state);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown_state else {
            panic!("{shown_state:?}")
        };
        assert!(reason.contains("(1 late)") && !reason.contains("refused"), "{reason}");
        monitor.record(&ProbeResult::Refused(NOT_PEERNET), now, &mut shown_state);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown_state else {
            panic!("{shown_state:?}")
        };
        assert!(reason.contains(NOT_PEERNET), "{reason}");
    }

    #[test]
    fn key_is_named_as_possible_reason() {
        assert_eq!(unanswered_reason(false, None), None);
        for refusal_reason in [None, Some("not authenticated by the key"), Some("shorter than a reply")] {
            let reason = unanswered_reason(true, refusal_reason).expect("a reason is known");
            assert!(reason.contains("both ends need the same key"), "{reason}");
            assert!(refusal_reason.is_none_or(|refusal_reason| reason.contains(refusal_reason)), "{reason}");
        }
        for other_reason in [WRONG_PROCESS, NOT_PEERNET, ALTERED_REPLY_TLVS, ALTERED_PROBE_TLVS, NO_ORIGIN] {
            let reason = unanswered_reason(true, Some(other_reason)).expect("a reason is known");
            assert!(reason.contains(other_reason) && !reason.contains("key"), "{reason}");
        }
        assert!(
            unanswered_reason(false, Some("not from the target"))
                .is_some_and(|reason| !reason.contains("key"))
        );
    }
}
