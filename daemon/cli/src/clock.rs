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

/// Returns `system_clock` itself if `faults` is `None`. Otherwise returns a clock that has the
/// errors of `[clock_fault]` from now on.
///
/// # Errors
/// When the kernel's boot id cannot be read.
pub fn with_faults(system_clock: &SharedClock, faults: Option<&ClockFaultConfig>) -> io::Result<SharedClock> {
    let Some(faults) = faults else { return Ok(Arc::clone(system_clock)) };
    let since = system_clock.wall();
    let identity = match &*system_clock.identity().clock {
        // The artificial drift starts from zero at each start of the program. Two starts are therefore two clocks, and
        // each gets a separate identity.
        ClockIdentity::SYSTEM => {
            let name = format!("clock-fault-{}-{:x}", std::process::id(), since.unix_nanos());
            ClockIdentity::from_system(&name)?
        }
        // An identity from the configuration is kept.
        _ => system_clock.identity().clone(),
    };
    Ok(Arc::new(FaultyClock::new(Arc::clone(system_clock), identity, faults.clock_faults(since))))
}
