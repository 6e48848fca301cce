//! Which clock a host reads.

use std::io;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// Identifies a wall clock: equal identities mean one and the same clock, so that the offset is exactly zero.
///
/// Every process of one machine since one boot reads one clock, containers included: the kernel's boot id
/// says so. The second part tells apart clocks that a test or a rehearsal sets up on one machine.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ClockIdentity {
    /// The kernel's boot id, a UUID in text form.
    pub boot: Arc<str>,
    /// `system` unless configured otherwise.
    pub clock: Arc<str>,
}

impl ClockIdentity {
    /// The second part of the identity when nothing else is configured.
    pub const SYSTEM: &'static str = "system";

    const BOOT_ID: &'static str = "/proc/sys/kernel/random/boot_id";

    /// An identity of two given parts.
    pub fn new(boot: &str, clock: &str) -> Self {
        Self { boot: boot.into(), clock: clock.into() }
    }

    /// The identity of this machine's wall clock; `clock` is [`Self::SYSTEM`] or a name of one's own.
    ///
    /// # Errors
    /// When the kernel's boot id cannot be read; the error names the file.
    pub fn of_this_machine(clock: &str) -> io::Result<Self> {
        let boot = std::fs::read_to_string(Self::BOOT_ID).map_err(|error| {
            io::Error::new(error.kind(), format!("cannot read {}: {error}", Self::BOOT_ID))
        })?;
        Ok(Self::new(boot.trim(), clock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_reads_on_one_machine_agree_and_a_named_clock_differs() {
        let a = ClockIdentity::of_this_machine(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let b = ClockIdentity::of_this_machine(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let other = ClockIdentity::of_this_machine("rehearsal").expect("linux has a boot id");
        assert_eq!(a, b);
        assert_ne!(a, other);
    }
}
