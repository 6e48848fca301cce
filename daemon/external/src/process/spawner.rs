//! One thread that starts all processes.
//!
//! The kernel ends a process "with its parent" when the *thread* that started it ends, and threads of pools come and
//! go. This one stays as long as the program.

use std::io;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

struct Order {
    command: Command,
    reply: SyncSender<io::Result<Child>>,
}

/// Starts a process.
pub(super) fn spawn(command: Command) -> io::Result<Child> {
    static SPAWNER: OnceLock<SyncSender<Order>> = OnceLock::new();
    let gone = || io::Error::other("the thread that starts processes is gone");
    let orders = match SPAWNER.get() {
        Some(orders) => orders,
        None => {
            let (orders, taken) = sync_channel(1);
            thread::Builder::new().name("spawner".to_owned()).spawn(move || serve(&taken))?;
            // When two threads are first, the other one's spawner stays and this one's ends at once.
            SPAWNER.get_or_init(|| orders)
        }
    };
    let (reply, started) = sync_channel(1);
    orders.send(Order { command, reply }).map_err(|_| gone())?;
    started.recv().map_err(|_| gone())?
}

fn serve(orders: &Receiver<Order>) {
    for Order { mut command, reply } in orders {
        // Whoever asked waits for the answer.
        let _ = reply.send(command.spawn());
    }
}
