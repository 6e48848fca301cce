//! The thread that starts all processes.
//!
//! The kernel sends the parent-death signal when the *thread* that started the process ends. Threads of a pool may
//! end at any time; the spawner thread runs until PEERNet ends.

use std::io;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

/// Request to start a process.
struct SpawnRequest {
    command: Command,
    reply: SyncSender<io::Result<Child>>,
}

/// Starts a process on the spawner thread.
pub(super) fn spawn(command: Command) -> io::Result<Child> {
    static SPAWNER: OnceLock<SyncSender<SpawnRequest>> = OnceLock::new();
    let spawner_gone = || io::Error::other("the thread that starts processes has ended");
    let requests = match SPAWNER.get() {
        Some(requests) => requests,
        None => {
            let (requests, receiver) = sync_channel(1);
            thread::Builder::new().name("spawner".to_owned()).spawn(move || serve(&receiver))?;
            // If two threads get here at the same time, the second spawner ends, because its sender is dropped.
            SPAWNER.get_or_init(|| requests)
        }
    };
    let (reply, result) = sync_channel(1);
    requests.send(SpawnRequest { command, reply }).map_err(|_| spawner_gone())?;
    result.recv().map_err(|_| spawner_gone())?
}

/// Starts a process for each request.
fn serve(requests: &Receiver<SpawnRequest>) {
    for SpawnRequest { mut command, reply } in requests {
        // The requester waits for the reply, so sending the reply cannot fail.
        let _ = reply.send(command.spawn());
    }
}
