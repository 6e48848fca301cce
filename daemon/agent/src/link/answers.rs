//! Whether probes come back, and what is known when they do not. No I/O.

use peernet_clock::{LogThrottle, MonoTime};
use peernet_logger::Slug;
use peernet_probes::ProbeResult;
use peernet_probes::stamp::sender::{ALTERED_ANSWER, ALTERED_PROBE, ANOTHER_PROCESS, NOT_OURS, UNNAMED};
use peernet_stream::Probing;

/// So many probes lost in a row, and the link counts as one whose probes are not answered.
const SILENCE: u32 = 3;

/// Why probes count as unanswered whose answers come too late.
const LATE_ANSWERS: &str = "answers arrive more than 2 s after their probes, which count as lost";

/// Decides from what became of the probes to one reflector whether they are shown as answered.
#[derive(Debug)]
pub(super) struct Answers {
    /// The name of the cloud, for the log.
    peer: Slug,
    /// This end has a key of its own.
    keyed: bool,
    /// Sent, and neither answered nor lost.
    under_way: u32,
    /// Lost in a row.
    lost: u32,
    /// How it was probed while they came back.
    before: Option<Probing>,
    /// What was refused last since one was taken.
    refused: Option<&'static str>,
    /// So many were refused since one was taken.
    refusals: u32,
    /// So many answers were late since one was in time.
    late: u32,
    /// Whoever sends garbage does not fill the log.
    log: LogThrottle,
}

impl Answers {
    /// Of a reflector that was asked nothing.
    pub(super) fn new(peer: Slug, keyed: bool) -> Self {
        let log = LogThrottle::default();
        Self { peer, keyed, under_way: 0, lost: 0, before: None, refused: None, refusals: 0, late: 0, log }
    }

    /// Number of probes that were sent and neither answered nor lost.
    pub(super) const fn under_way(&self) -> u32 {
        self.under_way
    }

    /// Takes what became of a probe by now, and changes what is shown.
    pub(super) fn note(&mut self, result: &ProbeResult, now: MonoTime, shown: &mut Probing) {
        match result {
            ProbeResult::Sent => self.under_way = self.under_way.saturating_add(1),
            ProbeResult::Lost => {
                self.under_way = self.under_way.saturating_sub(1);
                self.lost = self.lost.saturating_add(1);
                if self.lost >= SILENCE
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
                        "probes go wrong: {why} (told once a minute at most, with the number since then)"
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

/// What keeps probes from being answered, as far as this end can know: whether it has a key, and what came back and was
/// refused. `None` when nothing tells it from a blocked port.
fn why_unanswered(key: bool, refused: Option<&str>) -> Option<String> {
    match (key, refused) {
        // Authentic, where there is a key.
        (_, Some(why @ (ANOTHER_PROCESS | NOT_OURS))) => Some(format!(
            "{why}; the data's address must lead to one machine, for UDP too: see forwarded ports and load balancers"
        )),
        (_, Some(why @ (ALTERED_ANSWER | ALTERED_PROBE | UNNAMED))) => {
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
    fn late_answers_are_the_reason_and_not_refused() {
        let mut answers = Answers::new("cloud".parse().expect("a name"), true);
        let address = "udp://10.0.0.3:862".to_owned();
        let mut shown = Probing::On { address, rate_hz: 10.0, stamps: "kernel".into() };
        let now = MonoTime::from_nanos(0);
        for _ in 0..SILENCE {
            answers.note(&ProbeResult::Sent, now, &mut shown);
            answers.note(&ProbeResult::Lost, now, &mut shown);
        }
        answers.note(&ProbeResult::Late, now, &mut shown);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown else { panic!("{shown:?}") };
        assert!(reason.contains("(1 late)") && !reason.contains("refused"), "{reason}");
        answers.note(&ProbeResult::Refused(NOT_OURS), now, &mut shown);
        let Probing::Unanswered { reason: Some(reason), .. } = &shown else { panic!("{shown:?}") };
        assert!(reason.contains(NOT_OURS), "{reason}");
    }

    #[test]
    fn a_key_is_named_where_it_can_be_the_matter() {
        assert_eq!(why_unanswered(false, None), None);
        for refused in [None, Some("not authenticated by the key"), Some("shorter than a reply")] {
            let reason = why_unanswered(true, refused).expect("something is known");
            assert!(reason.contains("both ends need the same key"), "{reason}");
            assert!(refused.is_none_or(|refused| reason.contains(refused)), "{reason}");
        }
        for another in [ANOTHER_PROCESS, NOT_OURS, ALTERED_ANSWER, ALTERED_PROBE, UNNAMED] {
            let reason = why_unanswered(true, Some(another)).expect("something is known");
            assert!(reason.contains(another) && !reason.contains("key"), "{reason}");
        }
        assert!(
            why_unanswered(false, Some("not from the target")).is_some_and(|reason| !reason.contains("key"))
        );
    }
}
