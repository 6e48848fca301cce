//! State shortly after an aggregator's start, when known agents have not reconnected yet.

use peernet_aggregator::LiveState;
use peernet_clock::{Span, WallTime};

use super::counted;

/// Sentence shown in place of those that no host has reported or that nothing runs.
pub(crate) const WAITING: &str = "Waiting for agents to report";
/// Time after which an agent that has not reported is absent; agents reconnect every few seconds.
const PATIENCE: Span = Span::from_seconds(15);

/// Returns whether agents may still be on their way to an aggregator that serves since then: what it does not see is not
/// known to be missing.
pub(crate) fn starting(snapshot: &LiveState, since: WallTime) -> bool {
    let known = snapshot.absent > 0 || !snapshot.hosts.is_empty();
    known && snapshot.pipelines.is_empty() && (snapshot.hosts.is_empty() || snapshot.at - since < PATIENCE)
}

/// Returns `2 hosts are known from before`; `None` where none is.
pub(crate) fn known(snapshot: &LiveState) -> Option<String> {
    (snapshot.absent > 0).then(|| {
        let verb = if snapshot.absent == 1 { "is" } else { "are" };
        format!("{} {verb} known from before", counted(snapshot.absent, "host", "hosts"))
    })
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;

    use super::*;
    use crate::tests::samples::{host, pipeline, snapshot};

    #[test]
    fn agents_are_awaited_for_a_while_and_those_known_from_before_until_one_comes() {
        let mut shown = snapshot(Vec::new(), Vec::new());
        let (now, long_ago) = (shown.at - Span::from_seconds(3), shown.at - Span::from_seconds(3_600));
        assert!(!starting(&shown, now), "a new aggregator knows nobody");
        shown.absent = 2;
        assert_eq!(known(&shown).as_deref(), Some("2 hosts are known from before"));
        assert!(starting(&shown, now) && starting(&shown, long_ago));

        let mut shown = snapshot(vec![host("rack-a", "EPYC")], Vec::new());
        shown.absent = 1;
        assert!(starting(&shown, now) && !starting(&shown, long_ago), "the other one is away by then");
        shown.pipelines.push(pipeline("line", 5.0, 1.0, Verdict::Ok, &[]).into());
        assert!(!starting(&shown, now), "one runs");
    }
}
