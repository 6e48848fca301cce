//! Time daemons for both hosts. They do not change the machine's clock.
//!
//! Their server runs in the namespace of the tests and is reached through the hosts' second interfaces, so that the
//! daemons' estimates do not depend on the measured path.

use std::path::{Path, PathBuf};

use peernet_test_ports::free_port;

use super::{Host, Network};
use crate::{Process, chrony};

/// Port of chronyd's commands. It can be fixed, because each namespace has its own ports.
const COMMAND_PORT: &str = "323";

/// A chronyd for each host, and the server that they follow.
#[derive(Debug)]
pub struct TimeDaemons {
    _hosts: [Process; 2],
    _server: Process,
}

impl TimeDaemons {
    /// Starts the daemons and waits until both hosts are synchronised.
    ///
    /// # Panics
    /// If chrony is missing, or does not synchronise a host within a minute.
    pub fn start(network: &Network, folder: &Path) -> Self {
        let port = free_port();
        let allowed = network.slot.address(0);
        let lines = format!("local stratum 10\nallow {allowed}/24\nport {port}\ncmdport 0\n");
        let file = configuration(folder, "server", &lines);
        let server = Process::start(&chrony("chronyd"), &arguments(&file), folder, &[]);
        let hosts = [&network.edge, &network.cloud];
        let clients = hosts.map(|host| start_chronyd(host, port, folder));
        for host in hosts {
            // Right after its first measurement chrony reports an unknown rate of the clock. This waits until the
            // rate is known to 100 ppm, and asks ten times a second.
            let waitsync = ["-h", "127.0.0.1", "-p", COMMAND_PORT, "waitsync", "600", "0", "100", "0.1"];
            host.run(&chrony("chronyc").display().to_string(), &waitsync);
        }
        Self { _hosts: clients, _server: server }
    }

    /// Returns the table `[clock]` of an agent that asks only its host's chronyd.
    pub fn table() -> String {
        let chronyc = chrony("chronyc").display().to_string();
        format!(
            "[clock]\ndiscipline = [\"chrony\"]\ndiscipline_interval_s = 0.5\nchronyc = \"{chronyc}\"\n\
             chronyc_arguments = [\"-h\", \"127.0.0.1\", \"-p\", \"{COMMAND_PORT}\"]\n"
        )
    }
}

/// Starts the chronyd of a host.
fn start_chronyd(host: &Host, port: u16, folder: &Path) -> Process {
    let lines = format!(
        "server {} port {port} iburst minpoll -2 maxpoll 0\nport 0\ncmdport {COMMAND_PORT}\nbindcmdaddress 127.0.0.1\n",
        host.test_address
    );
    let file = configuration(folder, &host.namespace, &lines);
    host.start(&chrony("chronyd"), &arguments(&file), folder, &[])
}

fn configuration(folder: &Path, name: &str, lines: &str) -> PathBuf {
    let file = folder.join(format!("{name}.chrony.conf"));
    let pid = file.with_extension("pid").display().to_string();
    // `bindcmdaddress /` means no Unix socket for commands.
    std::fs::write(&file, format!("{lines}bindcmdaddress /\npidfile {pid}\n"))
        .expect("the temporary folder is writable");
    file
}

/// Returns the arguments of chronyd: `-x` leaves the clock unchanged, `-d` logs to standard error.
fn arguments(file: &Path) -> Vec<String> {
    let file = file.display().to_string();
    ["-x", "-d", "-U", "-u", "root", "-f", &file].map(str::to_owned).into()
}
