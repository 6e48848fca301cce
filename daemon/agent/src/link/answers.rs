//! Whether probes come back, and what is known when they do not.

use peernet_probes::ProbeResult;
use peernet_probes::stamp::sender::{ANOTHER_PROCESS, NOT_OURS};
use peernet_stream::Probing;

use super::pair::Link;

/// So many probes lost in a row, and the link counts as one whose probes are not answered.
const SILENCE: u32 = 3;

/// What became of the probes to one cloud.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// Sent, and neither answered nor lost.
    pub(super) under_way: u32,
    /// Lost in a row.
    lost: u32,
    /// How it was probed while they came back.
    before: Option<Probing>,
    /// What was refused last: said once, not at each packet.
    refused: Option<&'static str>,
    /// So many were refused since one was taken.
    refusals: u32,
}

impl Answers {
    pub(super) fn note(&mut self, result: &ProbeResult, link: &Link) {
        match result {
            ProbeResult::Sent => self.under_way = self.under_way.saturating_add(1),
            ProbeResult::Lost => {
                self.under_way = self.under_way.saturating_sub(1);
                self.lost = self.lost.saturating_add(1);
                let now = link.probing();
                if self.lost >= SILENCE
                    && let Probing::On { address, .. } = &now
                {
                    link.set_probing(self.unanswered(address.clone(), link));
                    self.before = Some(now);
                }
            }
            ProbeResult::Answered(_) | ProbeResult::Stepped(_) => {
                self.under_way = self.under_way.saturating_sub(1);
                (self.lost, self.refused, self.refusals) = (0, None, 0);
                if let Some(on) = self.before.take() {
                    link.set_probing(on);
                }
            }
            ProbeResult::Refused(why) => {
                self.refusals = self.refusals.saturating_add(1);
                if self.refused.replace(why) != Some(why) {
                    tracing::warn!(peer = %link.name, "probes go wrong: {why}");
                }
                if let Probing::Unanswered { address, .. } = link.probing() {
                    link.set_probing(self.unanswered(address, link));
                }
            }
            ProbeResult::Refined(_) => {}
        }
    }

    fn unanswered(&self, address: String, link: &Link) -> Probing {
        let reason = why_unanswered(link.shared.probes.key.is_some(), self.refused);
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
    use super::why_unanswered;

    #[test]
    fn a_key_is_named_where_it_can_be_the_matter() {
        assert_eq!(why_unanswered(false, None), None);
        for refused in [None, Some("not authenticated by the key"), Some("shorter than a reply")] {
            let reason = why_unanswered(true, refused).expect("something is known");
            assert!(reason.contains("both ends need the same key"), "{reason}");
            assert!(refused.is_none_or(|refused| reason.contains(refused)), "{reason}");
        }
        for another in [super::ANOTHER_PROCESS, super::NOT_OURS] {
            assert!(why_unanswered(true, Some(another)).is_some_and(|reason| !reason.contains("key")));
        }
        assert!(
            why_unanswered(false, Some("not from the target")).is_some_and(|reason| !reason.contains("key"))
        );
    }
}
