//! Numbers that separate the networks of concurrent tests.

use std::fs::{File, TryLockError};
use std::io;
use std::net::Ipv4Addr;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, geteuid, pidfd_open, pidfd_send_signal};

use super::command::try_run;

/// Longest time that a killed process may take to exit.
const EXIT_TIMEOUT: Timespec = Timespec { tv_sec: 10, tv_nsec: 0 };

/// Number that no other test on this machine uses now, with the names and addresses derived from it.
#[derive(Debug)]
pub(super) struct Slot {
    number: u8,
    /// Lock that marks the number as used; the kernel releases it when a test is killed.
    _lock: File,
}

impl Slot {
    /// Acquires a free number, and removes what a killed test with that number left behind.
    pub(super) fn acquire() -> Self {
        assert!(
            geteuid().is_root(),
            "this test makes network namespaces, which needs root: run it as root, for instance with sudo -E"
        );
        let folder = std::env::temp_dir().join("peernet-tests");
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        for number in 0..=u8::MAX {
            let lock = File::create(folder.join(format!("network-{number}.lock")))
                .expect("the temporary folder is writable");
            match lock.try_lock() {
                Ok(()) => {
                    let slot = Self { number, _lock: lock };
                    slot.remove_namespaces();
                    return slot;
                }
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Error(error)) => {
                    panic!("cannot lock a file in {}: {error}", folder.display())
                }
            }
        }
        panic!("all 256 networks of tests are in use");
    }

    /// Returns the name of a namespace.
    pub(super) fn name(&self, role: &str) -> String {
        format!("{}{role}", self.prefix())
    }

    fn prefix(&self) -> String {
        format!("peernet-test-{}-", self.number)
    }

    /// Returns the name of an interface in the namespace of the tests.
    pub(super) fn interface(&self, role: &str) -> String {
        format!("pt{}{role}", self.number)
    }

    /// Returns the address with this last octet.
    pub(super) const fn address(&self, last_octet: u8) -> Ipv4Addr {
        Ipv4Addr::new(10, 213, self.number, last_octet)
    }

    /// Ends all processes in the namespaces of this number and removes the namespaces and their interfaces.
    pub(super) fn remove_namespaces(&self) {
        // Edge, cloud and third host.
        for role in ["e", "c", "t"] {
            // The interface need not exist.
            let _ = try_run("ip", &["link", "delete", &self.interface(role)]);
        }
        let namespaces = try_run("ip", &["netns", "list"]).unwrap_or_default();
        let names = namespaces.lines().filter_map(|line| line.split_whitespace().next());
        for namespace in names.filter(|name| name.starts_with(&self.prefix())) {
            let pids = try_run("ip", &["netns", "pids", namespace]).unwrap_or_default();
            for pid in pids.lines().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)) {
                if let Err(problem) = kill_and_await_exit(pid) {
                    print_problem(&format!("cannot end process {pid:?} in {namespace}: {problem}"));
                }
            }
            if let Err(problem) = try_run("ip", &["netns", "delete", namespace]) {
                print_problem(&problem);
            }
        }
    }
}

/// Kills a process and waits until it has exited; its parent need not have collected its status.
///
/// # Errors
/// If the process cannot be killed, or still exists after [`EXIT_TIMEOUT`].
fn kill_and_await_exit(pid: Pid) -> io::Result<()> {
    // A descriptor cannot refer to another process that got the number later.
    let process = match pidfd_open(pid, PidfdFlags::empty()) {
        // A process that has just ended by itself needs no signal.
        Err(rustix::io::Errno::SRCH) => return Ok(()),
        opened => opened?,
    };
    match pidfd_send_signal(&process, Signal::KILL) {
        Ok(()) | Err(rustix::io::Errno::SRCH) => {}
        Err(error) => return Err(error.into()),
    }
    // The call returns before the kernel has ended the process. Until its end the process keeps its namespace.
    match poll(&mut [PollFd::new(&process, PollFlags::IN)], Some(&EXIT_TIMEOUT))? {
        0 => Err(io::Error::new(io::ErrorKind::TimedOut, "it has not exited 10 s after it was killed")),
        _ => Ok(()),
    }
}

#[expect(clippy::print_stderr, reason = "a drop must not panic, and the problem must be visible")]
fn print_problem(problem: &str) {
    eprintln!("{problem}");
}
