//! Which clock a host reads.

use std::io;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// Identifies the clocks of a process: equal identities mean one and the same clock, so that the offset is exactly zero.
///
/// Every process of one machine since one boot reads one clock, containers included, unless a time namespace shifts what it
/// reads. The second part tells apart clocks that a test or a rehearsal sets up on one machine.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ClockIdentity {
    /// The kernel's boot id, a UUID in text form; in a time namespace followed by `/` and the namespace, as `time:[4026532280]`.
    pub boot: Arc<str>,
    /// `system` unless configured otherwise.
    pub clock: Arc<str>,
}

impl ClockIdentity {
    /// The second part of the identity when nothing else is configured.
    pub const SYSTEM: &'static str = "system";

    const BOOT_ID: &'static str = "/proc/sys/kernel/random/boot_id";
    const TIME_NAMESPACE: &'static str = "/proc/self/ns/time";
    /// The namespace that every process is in which was put into no other one (`PROC_TIME_INIT_INO` of Linux).
    const INITIAL_TIME_NAMESPACE: &'static str = "time:[4026531834]";

    /// An identity of two given parts.
    pub fn new(boot: &str, clock: &str) -> Self {
        Self { boot: boot.into(), clock: clock.into() }
    }

    /// The identity of this process's clocks; `clock` is [`Self::SYSTEM`] or a name of one's own.
    ///
    /// # Errors
    /// When the kernel's boot id or the time namespace cannot be read; the error names the file.
    pub fn of_this_machine(clock: &str) -> io::Result<Self> {
        let unreadable = |path: &'static str| {
            move |error: io::Error| io::Error::new(error.kind(), format!("cannot read {path}: {error}"))
        };
        let boot = std::fs::read_to_string(Self::BOOT_ID).map_err(unreadable(Self::BOOT_ID))?;
        let namespace = match std::fs::read_link(Self::TIME_NAMESPACE) {
            Ok(namespace) => namespace.to_string_lossy().into_owned(),
            // A kernel without time namespaces.
            Err(error) if error.kind() == io::ErrorKind::NotFound => Self::INITIAL_TIME_NAMESPACE.to_owned(),
            Err(error) => return Err(unreadable(Self::TIME_NAMESPACE)(error)),
        };
        Ok(Self::in_namespace(boot.trim(), &namespace, clock))
    }

    /// The initial namespace is left out, so that releases which do not look at namespaces tell the same of it.
    fn in_namespace(boot: &str, namespace: &str, clock: &str) -> Self {
        if namespace == Self::INITIAL_TIME_NAMESPACE {
            Self::new(boot, clock)
        } else {
            Self::new(&format!("{boot}/{namespace}"), clock)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_of_another_time_namespace_are_others() {
        let identity = |namespace| ClockIdentity::in_namespace("boot", namespace, ClockIdentity::SYSTEM);
        let initial = identity("time:[4026531834]");
        assert_eq!(initial, ClockIdentity::new("boot", "system"));
        assert_ne!(initial, identity("time:[4026532280]"));
        assert_ne!(identity("time:[4026532281]"), identity("time:[4026532280]"));
    }

    #[test]
    fn two_reads_on_one_machine_agree_and_a_named_clock_differs() {
        let a = ClockIdentity::of_this_machine(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let b = ClockIdentity::of_this_machine(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let other = ClockIdentity::of_this_machine("rehearsal").expect("linux has a boot id");
        assert_eq!(a, b);
        assert_ne!(a, other);
    }
}
