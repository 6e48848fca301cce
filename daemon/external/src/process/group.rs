//! A process, and the group that it and all it starts belong to.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};

use rustix::process::{Pid, Signal, kill_process_group};

use super::spawner;

/// What the watcher runs. Its standard input ends with this program, however that ends, and it then kills the group that
/// it is in. It outlives the group's being asked to end.
const WATCH: &str = "trap '' HUP INT QUIT TERM USR1 USR2; read -r _; kill -KILL 0";

/// A process that leads a group, and a watcher in that group.
///
/// The group's number is the leader's. The system gives it to nobody else as long as the leader's status has not been
/// taken, so the group can be signalled until then, whether or not the leader still runs.
#[derive(Debug)]
pub(super) struct Group {
    leader: Child,
    watcher: Option<Watcher>,
}

#[derive(Debug)]
struct Watcher {
    child: Child,
    /// Held, never written to.
    _alive: Option<ChildStdin>,
}

impl Group {
    /// Starts a command as the leader of a new group.
    pub(super) fn start(mut command: Command) -> io::Result<Self> {
        command.process_group(0);
        let leader = spawner::spawn(command)?;
        let watcher = Watcher::start(&leader)
            // Without it only the leader ends when this program is killed.
            .inspect_err(|error| tracing::warn!(%error, "nobody watches over the processes of a program"))
            .ok();
        Ok(Self { leader, watcher })
    }

    /// The process that leads it.
    pub(super) fn leader(&mut self) -> &mut Child {
        &mut self.leader
    }

    /// The number of the leader and of the group.
    pub(super) fn id(&self) -> u32 {
        self.leader.id()
    }

    pub(super) fn pid(&self) -> Option<Pid> {
        i32::try_from(self.id()).ok().and_then(Pid::from_raw)
    }

    /// Asks all of it to end (SIGTERM). Only before [`finish`](Self::finish).
    pub(super) fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Kills what is left of it, then takes the leader's status: in this order, because the number is free afterwards.
    pub(super) fn finish(&mut self) -> Option<ExitStatus> {
        self.signal(Signal::KILL);
        // A leader that moved to another group; one that has ended cannot be killed, and need not be.
        let _ = self.leader.kill();
        let status = self.leader.wait().ok();
        if let Some(mut watcher) = self.watcher.take() {
            // It was killed with the others: what its status is tells nothing.
            let _ = watcher.child.wait();
        }
        status
    }

    fn signal(&self, signal: Signal) {
        if let Some(pid) = self.pid() {
            // Its last member may be one that has ended.
            let _ = kill_process_group(pid, signal);
        }
    }
}

impl Watcher {
    fn start(leader: &Child) -> io::Result<Self> {
        let group = i32::try_from(leader.id()).map_err(io::Error::other)?;
        let mut command = Command::new("/bin/sh");
        command.args(["-c", WATCH, "peernet-watcher"]).process_group(group).current_dir("/");
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = command.spawn()?;
        Ok(Self { _alive: child.stdin.take(), child })
    }
}
