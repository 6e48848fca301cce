//! State shortly after the start of an aggregator, when known agents have not reconnected yet.

use peernet_aggregator::LiveState;
use peernet_clock::{Span, WallTime};
use peernet_statistics::number;

/// Title that replaces "no host has reported" and "no pipeline runs" while agents may still reconnect.
pub(crate) const WAITING: &str = "Waiting for agents to report";
/// Time after which an agent that has not reported counts as absent. Agents try to reconnect every few seconds.
const RECONNECT_TIMEOUT: Span = Span::from_seconds(15);

/// Returns whether agents may still reconnect to an aggregator that started at `since`. Until then, a host or pipeline
/// that has not reported is not missing.
pub(crate) fn is_waiting_for_agents(snapshot: &LiveState, since: WallTime) -> bool {
    let has_known_hosts = snapshot.absent > 0 || !snapshot.hosts.is_empty();
    // The time is negative if the aggregator's clock was set back; then the time since the start is not known.
    let elapsed = snapshot.at - since;
    // As long as not even one host has reported, the page has nothing else to show, so the time does not matter.
    has_known_hosts
        && snapshot.pipelines.is_empty()
        && (snapshot.hosts.is_empty() || !elapsed.is_negative() && elapsed < RECONNECT_TIMEOUT)
}

/// Returns a sentence such as `2 hosts are known from earlier`; `None` if no known host is absent.
pub(crate) fn absent_hosts_sentence(snapshot: &LiveState) -> Option<String> {
    (snapshot.absent > 0).then(|| {
        let verb = if snapshot.absent == 1 { "is" } else { "are" };
        format!("{} {verb} known from earlier", number::counted(snapshot.absent as u64, "host"))
    })
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;

    use super::*;
    use crate::tests::samples::{host, pipeline, snapshot};

    #[test]
    fn known_agents_are_expected_to_reconnect_after_start() {
        let mut shown = snapshot(Vec::new(), Vec::new());
        let (recently, long_ago) = (shown.at - Span::from_seconds(3), shown.at - Span::from_seconds(3_600));
        assert!(!is_waiting_for_agents(&shown, recently), "a new aggregator knows no host");
        shown.absent = 2;
        assert_eq!(absent_hosts_sentence(&shown).as_deref(), Some("2 hosts are known from earlier"));
        assert!(is_waiting_for_agents(&shown, recently) && is_waiting_for_agents(&shown, long_ago));

        let mut shown = snapshot(vec![host("rack-a", "EPYC")], Vec::new());
        shown.absent = 1;
        assert!(
            is_waiting_for_agents(&shown, recently) && !is_waiting_for_agents(&shown, long_ago),
            "after an hour, the absent host is missing"
        );
        let in_future = shown.at + Span::from_seconds(3_600);
        assert!(!is_waiting_for_agents(&shown, in_future), "the clock was set back by an hour");
        shown.pipelines.push(pipeline("line", 5.0, 1.0, Verdict::Ok, &[]).into());
        assert!(!is_waiting_for_agents(&shown, recently), "a pipeline has been reported");
    }
}
