//! Hint at the dashboard that shows a streamed run.

use std::fmt::Display;

use peernet_networks::Address;

/// Port of a dashboard unless its `[web] listen` sets another.
const PORT: u16 = 8040;

/// Returns a sentence about the dashboard that shows `subject`. `is_delivered` is `false` while events of the run wait
/// for delivery.
///
/// Only the aggregator's port for events is known here, so the sentence has the usual port of a dashboard.
pub(crate) fn dashboard_hint(subject: impl Display, aggregator: &Address, is_delivered: bool) -> String {
    if !is_delivered {
        let at = aggregator.authority();
        return format!(
            "{subject} will be on the dashboard of the aggregator at {at} once all events have been delivered"
        );
    }
    let host = aggregator.host();
    let at = if host.contains(':') { format!("[{host}]") } else { host.clone() };
    format!("see {subject} on the dashboard of the aggregator at {host} (usually http://{at}:{PORT})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_of_dashboard_works_in_browser() {
        let message = |text: &str| dashboard_hint("it", &text.parse().expect("an address"), true);
        let expected =
            "see it on the dashboard of the aggregator at 10.77.0.2 (usually http://10.77.0.2:8040)";
        assert_eq!(message("tcp://10.77.0.2:5650"), expected);
        assert!(message("tcp://[fd00::2]:5550").ends_with("at fd00::2 (usually http://[fd00::2]:8040)"));
    }

    #[test]
    fn run_with_undelivered_events_is_announced_for_later() {
        let message = dashboard_hint("it", &"tcp://10.77.0.2:5650".parse().expect("an address"), false);
        let later = "it will be on the dashboard of the aggregator at 10.77.0.2:5650 once all events have been delivered";
        assert_eq!(message, later);
    }
}
