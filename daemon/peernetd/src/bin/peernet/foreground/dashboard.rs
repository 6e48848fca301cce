//! Where a run that was streamed can be seen.

use peernet_networks::Address;

/// The port that a dashboard has unless its `[web] listen` says otherwise.
const PORT: u16 = 8040;

/// The dashboard of an aggregator, in words: of the aggregator only the event port is known here.
pub(crate) fn dashboard(aggregator: &Address) -> String {
    let host = aggregator.host();
    let at = if host.contains(':') { format!("[{host}]") } else { host.clone() };
    format!("the dashboard of the aggregator at {host} (usually http://{at}:{PORT})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_address_is_one_for_a_browser() {
        let told = |text: &str| dashboard(&text.parse().expect("an address"));
        let four = "the dashboard of the aggregator at 10.77.0.2 (usually http://10.77.0.2:8040)";
        assert_eq!(told("tcp://10.77.0.2:5650"), four);
        assert!(told("tcp://[fd00::2]:5550").ends_with("at fd00::2 (usually http://[fd00::2]:8040)"));
    }
}
