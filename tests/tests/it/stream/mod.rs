//! The event stream between real processes: what was spooled is stored once, whatever happens to whom.
//!
//! `make soak` runs the same tests longer (`PEERNET_KILLS`, `PEERNET_OUTAGE_ITERATIONS`, `PEERNET_OUTAGE_HZ`) and holds
//! them to more (`PEERNET_LAG_MS`, `PEERNET_CATCH_UP` in nodes per second). Each test prints what it counted.

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

use peernet_tests::{Fleet, Ledger};

/// These tests keep all cores busy: one after the other, none is slowed down beyond patience by the others.
pub(super) fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    // One that failed has cleaned up all the same.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// How often or how many: of an environment variable, or the usual.
pub(super) fn setting(variable: &str, usual: u64) -> u64 {
    match std::env::var(variable) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{variable}={text:?} is no number")),
        Err(_) => usual,
    }
}

/// A table of an agent that can measure faster than anyone stores: what waits for that stays a matter of seconds.
const SMALL_SPOOL: &str = "[spool]\nlimit_bytes = 8388608\n";

/// Checks that everything that the agents said is in their spools is stored, and that a run has no hole that is not a
/// gap. Returns how many iterations were said to be spooled.
fn nothing_lost(fleet: &Fleet, ledger: &Ledger) -> u64 {
    let mut spooled = 0;
    for agent in &fleet.agents {
        assert_eq!(ledger.lacks(agent.spooled()), 0, "lost of {}: {ledger:?}", agent.name);
        spooled += agent.spooled().iter().map(|line| line.count).sum::<u64>();
    }
    let gaps = ledger.hosts.values().any(|host| host.gaps > 0);
    for (id, run) in &ledger.runs {
        if !gaps {
            assert!(run.is_whole(), "holes in run {id}: {run:?}");
        } else if ["stopped", "finished"].contains(&run.reason.as_str()) {
            // One that was killed had no time to tell of its last losses.
            assert!(run.holes() <= run.missing, "holes in run {id} are not gaps: {run:?}");
        }
    }
    for (name, host) in &ledger.hosts {
        assert_eq!(host.quarantined, 0, "{name}: {host:?}");
    }
    spooled
}
