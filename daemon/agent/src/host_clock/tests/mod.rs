//! Tests of the whole module, with real clocks, real daemons and a clock that the test moves.

mod chronyd;
mod injected_faults;
mod real_chrony;

use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_networks::PeerClock;
use tokio::sync::watch;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::{initial_state, run};
use crate::config::{ClockConfig, ClockFaultConfig, HostConfig};
use crate::incidents::Incidents;

fn system_clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")))
}

/// Starts the task that monitors the clocks. The task runs until the guard is dropped.
fn start_watching(
    config: ClockConfig,
    faults: Option<ClockFaultConfig>,
    clock: &SharedClock,
) -> (watch::Receiver<PeerClock>, DropGuard) {
    let (event_queue, _) = crate::event_queue::create(
        &HostConfig::default(),
        clock,
        crate::event_queue::EventCounter::default(),
    );
    let incidents = Incidents::new(Arc::clone(clock), event_queue);
    let (publish, published) = watch::channel(initial_state(clock));
    let stop = CancellationToken::new();
    tokio::spawn(run(config, faults, Arc::clone(clock), incidents, publish, stop.clone()));
    (published, stop.drop_guard())
}
