//! Where a run that was streamed can be seen.

use std::fmt::Display;

use peernet_networks::Address;

/// The port that a dashboard has unless its `[web] listen` says otherwise.
const PORT: u16 = 8040;

/// A sentence that says where to look for what was streamed to an aggregator, once that has all of it. Of the aggregator
/// only the event port is known here.
pub(crate) fn where_seen(what: impl Display, aggregator: &Address, has_all: bool) -> String {
    if !has_all {
        let at = aggregator.authority();
        return format!(
            "{what} will be on the dashboard of the aggregator at {at} once all events have been delivered"
        );
    }
    let host = aggregator.host();
    let at = if host.contains(':') { format!("[{host}]") } else { host.clone() };
    format!("see {what} on the dashboard of the aggregator at {host} (usually http://{at}:{PORT})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_address_is_one_for_a_browser() {
        let told = |text: &str| where_seen("it", &text.parse().expect("an address"), true);
        let four = "see it on the dashboard of the aggregator at 10.77.0.2 (usually http://10.77.0.2:8040)";
        assert_eq!(told("tcp://10.77.0.2:5650"), four);
        assert!(told("tcp://[fd00::2]:5550").ends_with("at fd00::2 (usually http://[fd00::2]:8040)"));
    }

    #[test]
    fn nobody_is_sent_to_a_page_that_does_not_have_it_yet() {
        let told = where_seen("it", &"tcp://10.77.0.2:5650".parse().expect("an address"), false);
        let later = "it will be on the dashboard of the aggregator at 10.77.0.2:5650 once all events have been delivered";
        assert_eq!(told, later);
    }
}
