//! Tests of ownership: a host reports only for itself and its own runs, and proves its id.

mod foreign;
mod limit;
mod secret;

use peernet_tests::Fleet;
use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};

/// Starts a fleet with one agent that measures. Its host, `edge`, is the robot of these tests.
fn start_fleet(keys: &str) -> Fleet {
    let mut fleet = Fleet::with_aggregator_keys(
        keys,
        &["edge"],
        &agent_configuration("", &echo_pipeline("loop", &rate_load(100.0))),
    );
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 20);
    fleet
}
