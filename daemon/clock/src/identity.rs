//! Identity of the clocks that a host reads.

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

/// Identifies the clocks of a process.
///
/// The processes of one machine since one boot read one clock, containers included, unless a time namespace or a
/// preloaded library shifts what one of them reads. Clones of one snapshot of a virtual machine report the same boot
/// id. Equal identities therefore prove nothing: [`may_be_one_with`](Self::may_be_one_with) only tells whether a proof
/// can exist.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ClockIdentity {
    /// Boot id of the kernel, a UUID in text form; in a time namespace followed by `/` and the namespace, such as
    /// `time:[4026532280]`.
    pub boot: Arc<str>,
    /// `system` unless configured otherwise. Distinguishes clocks that a test or a clock fault injection sets up on one
    /// machine.
    pub clock: Arc<str>,
    /// Random number of the process that reads the clocks; `None` in releases before 0.3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<u64>,
}

impl ClockIdentity {
    /// Name of the clock when nothing else is configured.
    pub const SYSTEM: &'static str = "system";

    const BOOT_ID: &'static str = "/proc/sys/kernel/random/boot_id";
    const TIME_NAMESPACE: &'static str = "/proc/self/ns/time";
    /// Namespace of all processes that were not put into another one (`PROC_TIME_INIT_INO` of Linux).
    const INITIAL_TIME_NAMESPACE: &'static str = "time:[4026531834]";

    /// Creates an identity from two given parts, without a process.
    pub fn new(boot: &str, clock: &str) -> Self {
        Self { boot: boot.into(), clock: clock.into(), process: None }
    }

    /// Returns whether processes with these identities may read one clock: they state the same boot, time namespace and
    /// name.
    pub fn may_be_one_with(&self, other: &Self) -> bool {
        self.boot == other.boot && self.clock == other.clock
    }

    /// Returns the identity of this process's clocks; `clock` is [`Self::SYSTEM`] or a configured name.
    ///
    /// # Errors
    /// If the kernel's boot id or the time namespace cannot be read. The error names the file.
    pub fn of_this_machine(clock: &str) -> io::Result<Self> {
        let unreadable = |path: &'static str| {
            move |error: io::Error| io::Error::new(error.kind(), format!("cannot read {path}: {error}"))
        };
        let boot = std::fs::read_to_string(Self::BOOT_ID).map_err(unreadable(Self::BOOT_ID))?;
        let namespace = match std::fs::read_link(Self::TIME_NAMESPACE) {
            Ok(namespace) => namespace.to_string_lossy().into_owned(),
            // The kernel has no time namespaces.
            Err(error) if error.kind() == io::ErrorKind::NotFound => Self::INITIAL_TIME_NAMESPACE.to_owned(),
            Err(error) => return Err(unreadable(Self::TIME_NAMESPACE)(error)),
        };
        let identity = Self::in_namespace(boot.trim(), &namespace, clock);
        Ok(Self { process: Some(process()), ..identity })
    }

    /// Creates an identity for a time namespace. The initial one is left out, so that the identity equals that of
    /// releases which ignore namespaces.
    fn in_namespace(boot: &str, namespace: &str, clock: &str) -> Self {
        if namespace == Self::INITIAL_TIME_NAMESPACE {
            Self::new(boot, clock)
        } else {
            Self::new(&format!("{boot}/{namespace}"), clock)
        }
    }
}

/// Returns the random number of this process, drawn at the first call.
fn process() -> u64 {
    static PROCESS: OnceLock<u64> = OnceLock::new();
    *PROCESS.get_or_init(|| RandomState::new().hash_one(std::process::id()))
}

/// Returns the inode of the time namespace of this process; 0 if the kernel has no time namespaces.
///
/// # Errors
/// If the metadata of the namespace cannot be read. The error names the file.
pub fn time_namespace() -> io::Result<u64> {
    match std::fs::metadata(ClockIdentity::TIME_NAMESPACE) {
        Ok(namespace) => Ok(namespace.ino()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(0),
        Err(error) => {
            let text = format!("cannot look at {}: {error}", ClockIdentity::TIME_NAMESPACE);
            Err(io::Error::new(error.kind(), text))
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
        let other = ClockIdentity::of_this_machine("clock_fault").expect("linux has a boot id");
        assert_eq!(a, b);
        assert_ne!(a, other);
        assert!(a.may_be_one_with(&b) && !a.may_be_one_with(&other));
    }

    #[test]
    fn another_process_has_another_identity_and_perhaps_the_same_clock() {
        let ours = ClockIdentity::of_this_machine(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let theirs = ClockIdentity { process: ours.process.map(|process| process ^ 1), ..ours.clone() };
        assert_ne!(ours, theirs);
        assert!(ours.may_be_one_with(&theirs));
        assert!(ours.may_be_one_with(&ClockIdentity { process: None, ..theirs }), "an earlier release");
    }

    #[test]
    fn time_namespace_is_that_of_the_identity() {
        let link =
            std::fs::read_link(ClockIdentity::TIME_NAMESPACE).expect("this kernel has time namespaces");
        let inode = time_namespace().expect("it was just read");
        assert_eq!(link.display().to_string(), format!("time:[{inode}]"));
    }
}
