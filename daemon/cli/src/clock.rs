//! Choice of the clock that an agent reads.

use std::io;
use std::sync::Arc;

use peernet_agent::config::ClockFaultConfig;
use peernet_clock::{ClockIdentity, FaultyClock, SharedClock, SystemClock};

/// Returns this machine's clock under a given identity.
///
/// # Errors
/// When the kernel's boot id cannot be read.
pub fn system(identity: &str) -> io::Result<SharedClock> {
    Ok(Arc::new(SystemClock::new(ClockIdentity::from_system(identity)?)))
}

/// Returns `truth`, or a clock that has the errors of `[clock_fault]` from now on.
///
/// # Errors
/// When the kernel's boot id cannot be read.
pub fn with_faults(truth: &SharedClock, faults: Option<&ClockFaultConfig>) -> io::Result<SharedClock> {
    let Some(faults) = faults else { return Ok(Arc::clone(truth)) };
    let since = truth.wall();
    let identity = match &*truth.identity().clock {
        // Each start gives a different clock, because its drift starts from zero.
        ClockIdentity::SYSTEM => {
            let name = format!("clock-fault-{}-{:x}", std::process::id(), since.unix_nanos());
            ClockIdentity::from_system(&name)?
        }
        _ => truth.identity().clone(),
    };
    Ok(Arc::new(FaultyClock::new(Arc::clone(truth), identity, faults.description(since))))
}
