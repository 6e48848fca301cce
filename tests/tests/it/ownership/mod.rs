//! Whose data it is: a host speaks for itself and its own runs only, and proves that it is the host it says it is.

mod foreign;
mod limit;
mod secret;

use peernet_tests::Fleet;
use peernet_tests::fleet::{echo, edge, rate};

/// A fleet whose agent measures.
fn measuring(keys: &str) -> Fleet {
    let mut fleet = Fleet::aggregating(keys, &["edge"], &edge("", &echo("loop", &rate(100.0))));
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 20);
    fleet
}
