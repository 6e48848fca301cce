//! The aggregator, in a process without other parts of the benchmark.

use std::path::Path;
use std::sync::Arc;

use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio_util::sync::CancellationToken;

use crate::report;

/// Runs an aggregator until the standard input is closed. Prints the address that it listens on. `commit_nodes` 0 means
/// the default.
pub(crate) async fn run(database: &Path, commit_nodes: u64) {
    raise_file_limit();
    let mut config = AggregatorConfig {
        listen: "tcp://127.0.0.1:0".into(),
        database: database.to_owned(),
        ..AggregatorConfig::default()
    };
    if commit_nodes > 0 {
        config.commit_nodes = commit_nodes as usize;
    }
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "aggregator")));
    let stop = CancellationToken::new();
    let running = Aggregator::start(config, clock, stop.clone()).await.expect("starts");
    report(running.handle.live().borrow().listening.clone());
    let until_input_is_closed = || std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
    tokio::task::spawn_blocking(until_input_is_closed).await.expect("waits").expect("reads");
    stop.cancel();
    running.join().await.expect("ends well");
}

/// Raises the limit of open files as the systemd unit does: a thousand connections need a thousand file descriptors.
pub(crate) fn raise_file_limit() {
    let maximum = getrlimit(Resource::Nofile).maximum;
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).expect("raises the limit");
}
