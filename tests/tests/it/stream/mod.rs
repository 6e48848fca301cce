//! Tests of the event stream between real processes: spooled events are stored once, whichever process fails.
//!
//! `make soak` runs the same tests for longer (`PEERNET_KILLS`, `PEERNET_OUTAGE_ITERATIONS`, `PEERNET_OUTAGE_HZ`) and
//! with stricter limits (`PEERNET_LAG_MS`, `PEERNET_CATCH_UP` in nodes per second). Each test prints its counts.

mod accounting;
mod database_full;
mod hostile;
mod identity;
mod kills;
mod outage;
mod slow_link;
mod spool_full;
mod stopping;
mod versions;

use std::sync::{Mutex, MutexGuard, PoisonError};

use peernet_tests::{Fleet, StoredEvents};

/// Waits until no other of these tests runs. Each of them keeps all cores busy, so concurrent tests would exceed their
/// timeouts.
pub(super) fn wait_for_turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    // A failed test has cleaned up as well.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the value of an environment variable, or the default.
pub(super) fn setting(variable: &str, default: u64) -> u64 {
    match std::env::var(variable) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{variable}={text:?} is no number")),
        Err(_) => default,
    }
}

/// Table of an agent that can measure faster than the aggregator stores. The spool is small, so that its batches are
/// stored within seconds.
const SMALL_SPOOL: &str = "[spool]\nlimit_bytes = 8388608\n";

/// Checks that every batch that the agents reported as spooled is stored, and that all missing iterations of a run
/// are in gaps. Returns the number of spooled iterations.
fn assert_nothing_lost(fleet: &Fleet, stored_events: &StoredEvents) -> u64 {
    let mut spooled = 0;
    for agent in &fleet.agents {
        assert_eq!(
            stored_events.count_missing(agent.spooled_iterations()),
            0,
            "spooled iterations of {} are lost: {stored_events:?}",
            agent.name
        );
        spooled += agent.spooled_iterations().iter().map(|line| line.count).sum::<u64>();
    }
    let has_gaps = stored_events.hosts.values().any(|host| host.gaps > 0);
    for (id, run) in &stored_events.runs {
        if !has_gaps {
            assert!(run.is_contiguous(), "iterations of run {id} are missing, and there is no gap: {run:?}");
        } else if ["stopped", "finished"].contains(&run.reason.as_str()) {
            // An agent that was killed had no time to report its last losses.
            assert!(
                run.missing_iterations() <= run.missing,
                "missing iterations of run {id} are not in gaps: {run:?}"
            );
        }
    }
    for (name, host) in &stored_events.hosts {
        assert_eq!(host.quarantined, 0, "{name}: {host:?}");
    }
    spooled
}
