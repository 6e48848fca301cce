//! A process and its process group.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::spawner;

/// Shell command of the watcher. The watcher kills its process group when its standard input closes, and ignores the
/// signals that ask the group to end.
// The standard input closes when PEERNet ends, for whatever reason.
const WATCHER_SCRIPT: &str = "trap '' HUP INT QUIT TERM USR1 USR2; read -r _; kill -KILL 0";

/// A process that leads a process group, and a watcher in that group.
///
/// The group has the number of its leader. The system does not reuse the number until the leader's status has been
/// collected. Until then the group can be signalled, whether or not the leader still runs.
#[derive(Debug)]
pub(super) struct Group {
    leader: Child,
    watcher: Option<Watcher>,
}

// The parent-death signal of the kernel ends only the leader. The watcher ends the processes that the leader started.
#[derive(Debug)]
struct Watcher {
    child: Child,
    /// Write end of the watcher's standard input. The pipe is only kept open: nothing is written.
    _stdin: Option<ChildStdin>,
}

impl Group {
    /// Starts a command as the leader of a new group.
    pub(super) fn start(mut command: Command) -> io::Result<Self> {
        command.process_group(0);
        let leader = spawner::spawn(command)?;
        let watcher = Watcher::start(&leader)
            // Without a watcher, only the leader ends when PEERNet is killed.
            .inspect_err(|error| {
                tracing::warn!(
                    %error,
                    "cannot start the watcher of custom code; processes that the custom code starts may outlive PEERNet"
                );
            })
            .ok();
        Ok(Self { leader, watcher })
    }

    /// Returns the leader of the group.
    pub(super) fn leader(&mut self) -> &mut Child {
        &mut self.leader
    }

    /// Returns the process number of the leader, which is also the number of the group.
    pub(super) fn id(&self) -> u32 {
        self.leader.id()
    }

    pub(super) fn pid(&self) -> Option<Pid> {
        i32::try_from(self.id()).ok().and_then(Pid::from_raw)
    }

    /// Returns whether the leader has ended. Does not collect its status.
    pub(super) fn leader_has_ended(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        self.pid().is_some_and(|pid| matches!(waitid(WaitId::Pid(pid), options), Ok(Some(_))))
    }

    /// Asks all processes of the group to end (SIGTERM). Must not be called after [`finish`](Self::finish).
    pub(super) fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Kills all processes of the group, then collects the leader's status.
    // The group is killed first: after the status is collected, the system may give the group's number to another
    // process.
    pub(super) fn finish(&mut self) -> Option<ExitStatus> {
        self.signal(Signal::KILL);
        // Ends a leader that moved to another group. For a leader that has already ended the error does not matter.
        let _ = self.leader.kill();
        let status = self.leader.wait().ok();
        if let Some(mut watcher) = self.watcher.take() {
            // The watcher was killed with its group, so its status means nothing.
            let _ = watcher.child.wait();
        }
        status
    }

    fn signal(&self, signal: Signal) {
        if let Some(pid) = self.pid() {
            // This fails if the group's last member has already ended, which needs no action.
            let _ = kill_process_group(pid, signal);
        }
    }
}

impl Watcher {
    fn start(leader: &Child) -> io::Result<Self> {
        let group = i32::try_from(leader.id()).map_err(io::Error::other)?;
        let mut command = Command::new("/bin/sh");
        command.args(["-c", WATCHER_SCRIPT, "peernet-watcher"]).process_group(group).current_dir("/");
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        // Any thread may start the watcher. It needs no parent-death signal, because it ends with its standard input.
        let mut child = command.spawn()?;
        Ok(Self { _stdin: child.stdin.take(), child })
    }
}
