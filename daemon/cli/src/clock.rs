//! Choice of the clock that an agent reads.

use std::io;
use std::sync::Arc;

use peernet_agent::config::RehearsalConfig;
use peernet_clock::{ClockIdentity, FaultyClock, SharedClock, SystemClock};

/// Returns this machine's clock under a given identity.
///
/// # Errors
/// When the kernel's boot id cannot be read.
pub fn system(identity: &str) -> io::Result<SharedClock> {
    Ok(Arc::new(SystemClock::new(ClockIdentity::from_system(identity)?)))
}

/// Returns `truth`, or the clock that `[rehearsal]` makes of it from now on.
///
/// # Errors
/// When the kernel's boot id cannot be read.
pub fn rehearsed(truth: &SharedClock, rehearsal: Option<&RehearsalConfig>) -> io::Result<SharedClock> {
    let Some(rehearsal) = rehearsal else { return Ok(Arc::clone(truth)) };
    let since = truth.wall();
    let identity = match &*truth.identity().clock {
        // Each start is another clock: its drift begins again.
        ClockIdentity::SYSTEM => {
            let name = format!("rehearsal-{}-{:x}", std::process::id(), since.unix_nanos());
            ClockIdentity::from_system(&name)?
        }
        _ => truth.identity().clone(),
    };
    Ok(Arc::new(FaultyClock::new(Arc::clone(truth), identity, rehearsal.description(since))))
}
