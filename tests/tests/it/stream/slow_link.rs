//! Test of an agent whose events need about four times the rate of its link.

use std::time::Duration;

use peernet_tests::fleet::{echo_pipeline, rate_load};
use peernet_tests::network::CONTROL_INTERFACE;
use peernet_tests::{EventCounts, Network, Stopwatch, StoredEvents, TwoHostTestbed, print_line, wall};

use super::wait_for_turn;

const KBIT: u32 = 50;
const HZ: f64 = 100.0;
const ITERATIONS: u64 = 3_500;
/// Largest lag of the live state on a busy machine, seconds; 2.5 s were observed.
const MAX_LAG_S: f64 = 5.0;

#[test]
fn host_on_50_kbit_link_loses_nothing() {
    let _turn = wait_for_turn();
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let host = testbed.network.edge();
    host.throttle(CONTROL_INTERFACE, KBIT);
    let keys = format!("{}\nlimit = {{ total = {ITERATIONS} }}", rate_load(HZ));
    let model = "[[model]]\nname = \"echo\"\nkind = \"echo\"\n";
    let edge = testbed.start_edge(&format!("{model}{}", echo_pipeline("line", &keys)), &[]);
    let stopwatch = Stopwatch::start();
    let first =
        EventCounts::wait_until(&testbed.api, "edge", "the agent reports", |counts| counts.produced > 0);

    let (mut max_lag_s, mut stored, mut queries) = (0.0_f64, first.stored, 0);
    while stopwatch.elapsed() < Duration::from_secs(35) {
        let counts = EventCounts::read(&testbed.api, "edge").expect("the aggregator answers");
        assert!(counts.connected, "away after {:?}: {counts:?}", stopwatch.elapsed());
        assert!(counts.stored >= stored, "{counts:?}");
        counts.assert_balanced();
        max_lag_s = max_lag_s.max(counts.live_lag_s);
        (stored, queries) = (counts.stored, queries + 1);
        std::thread::sleep(Duration::from_millis(250));
    }
    print_line(&format!(
        "{KBIT} kbit/s: {max_lag_s:.2} s behind at most, {stored} events stored, asked {queries} times"
    ));
    assert!(max_lag_s <= MAX_LAG_S, "the live state lagged by {max_lag_s} s");
    // The link carries 219 kB in 35 s, and compressed events have some hundred bytes each.
    assert!(stored >= 300, "the durable lane stored {stored} events only");
    assert!(stored < ITERATIONS, "the link was not slow");

    host.remove_limit(CONTROL_INTERFACE);
    let counts = EventCounts::wait_until_at_rest(&testbed.api, "edge", wall());
    counts.assert_balanced();
    assert_eq!((counts.dropped, counts.gaps, counts.missing, counts.duplicates), (0, 0, 0, 0));
    let end = edge.stop();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(end.log.matches("connected to the aggregator").count(), 1, "{}", end.log);
    let database = testbed.folder().join("aggregator.sqlite");
    testbed.stop_and_inspect(|| {
        let stored_events = StoredEvents::read(&database);
        stored_events.assert_consistent();
        assert_eq!(stored_events.iterations(), ITERATIONS);
        assert!(
            stored_events.runs.values().all(|run| run.is_contiguous() && run.reason == "finished"),
            "{stored_events:?}"
        );
    });
}
