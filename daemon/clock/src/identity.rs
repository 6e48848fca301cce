//! Identity of the clocks that a host reads.

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

/// Identifies the clocks of a process.
///
/// All processes of one machine since one boot read the same clocks, also in containers, unless a time namespace or a
/// preloaded library shifts the clocks of one process. Equal identities do not prove that two processes read the same
/// clocks, because clones of one snapshot of a virtual machine report the same boot id.
/// [`may_share_clock_with`](Self::may_share_clock_with) only says whether two processes can read the same clocks.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ClockIdentity {
    /// Boot id of the kernel, a UUID in text form. In a time namespace, `/` and the name of the namespace follow, such
    /// as `time:[4026532280]`.
    pub boot: Arc<str>,
    /// Name of the clock, `system` by default. Distinguishes the clocks that a test or clock fault injection sets up on
    /// one machine.
    pub clock: Arc<str>,
    /// Random number of the process that reads the clocks; `None` in releases before 0.3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<u64>,
}

impl ClockIdentity {
    /// Default name of the clock.
    pub const SYSTEM: &'static str = "system";

    const BOOT_ID: &'static str = "/proc/sys/kernel/random/boot_id";
    const TIME_NAMESPACE: &'static str = "/proc/self/ns/time";
    /// The initial time namespace (`PROC_TIME_INIT_INO` of Linux).
    const INITIAL_TIME_NAMESPACE: &'static str = "time:[4026531834]";

    /// Creates an identity from a boot id and a name of the clock, without a process.
    pub fn new(boot: &str, clock: &str) -> Self {
        Self { boot: boot.into(), clock: clock.into(), process: None }
    }

    /// Returns whether processes with these identities may read one clock: boot, time namespace and name are equal.
    pub fn may_share_clock_with(&self, other: &Self) -> bool {
        self.boot == other.boot && self.clock == other.clock
    }

    /// Returns the identity of this process's clocks; `clock` is [`Self::SYSTEM`] or a configured name.
    ///
    /// # Errors
    /// If the kernel's boot id or the time namespace cannot be read. The error names the file.
    pub fn from_system(clock: &str) -> io::Result<Self> {
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
        Ok(Self { process: Some(process_number()), ..identity })
    }

    /// Creates an identity for a time namespace.
    // The initial namespace is left out, so that the identity equals the identity that releases without namespaces
    // compute.
    fn in_namespace(boot: &str, namespace: &str, clock: &str) -> Self {
        if namespace == Self::INITIAL_TIME_NAMESPACE {
            Self::new(boot, clock)
        } else {
            Self::new(&format!("{boot}/{namespace}"), clock)
        }
    }
}

/// Returns the random number of this process, drawn at the first call.
fn process_number() -> u64 {
    static PROCESS: OnceLock<u64> = OnceLock::new();
    // The keys of `RandomState` are random, so that no library for random numbers is needed.
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
            let text = format!("cannot read the metadata of {}: {error}", ClockIdentity::TIME_NAMESPACE);
            Err(io::Error::new(error.kind(), text))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_of_other_time_namespace_differ() {
        let identity = |namespace| ClockIdentity::in_namespace("boot", namespace, ClockIdentity::SYSTEM);
        let initial = identity("time:[4026531834]");
        assert_eq!(initial, ClockIdentity::new("boot", "system"));
        assert_ne!(initial, identity("time:[4026532280]"));
        assert_ne!(identity("time:[4026532281]"), identity("time:[4026532280]"));
    }

    #[test]
    fn identity_is_stable_but_other_clock_name_differs() {
        let a = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let b = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let other = ClockIdentity::from_system("clock_fault").expect("linux has a boot id");
        assert_eq!(a, b);
        assert_ne!(a, other);
        assert!(a.may_share_clock_with(&b) && !a.may_share_clock_with(&other));
    }

    #[test]
    fn other_process_differs_but_may_share_clock() {
        let ours = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
        let theirs = ClockIdentity { process: ours.process.map(|process| process ^ 1), ..ours.clone() };
        assert_ne!(ours, theirs);
        assert!(ours.may_share_clock_with(&theirs));
        assert!(
            ours.may_share_clock_with(&ClockIdentity { process: None, ..theirs }),
            "a process of an earlier release"
        );
    }

    #[test]
    fn time_namespace_equals_namespace_in_identity() {
        let link =
            std::fs::read_link(ClockIdentity::TIME_NAMESPACE).expect("this kernel has time namespaces");
        let inode = time_namespace().expect("it was just read");
        assert_eq!(link.display().to_string(), format!("time:[{inode}]"));
    }
}
