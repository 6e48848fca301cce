//! Real time daemons for both hosts, which leave the machine's clock alone.
//!
//! Their server stands in the namespace that the tests run in and is reached over the hosts' second interfaces: what
//! happens on the measured path is not what their claims rest on.

use std::path::{Path, PathBuf};

use peernet_test_ports::free_port;

use super::{Host, Network};
use crate::{Process, chrony};

/// A namespace has all ports for itself.
const COMMANDS: &str = "323";

/// A chronyd for each host, and the one that they follow.
#[derive(Debug)]
pub struct TimeDaemons {
    _hosts: [Process; 2],
    _server: Process,
}

impl TimeDaemons {
    /// Starts them and waits until both hosts are synchronised.
    ///
    /// # Panics
    /// When chrony is missing, or does not synchronise a host within a minute.
    pub fn start(network: &Network, folder: &Path) -> Self {
        let port = free_port();
        let allowed = network.slot.address(0);
        let lines = format!("local stratum 10\nallow {allowed}/24\nport {port}\ncmdport 0\n");
        let file = configuration(folder, "server", &lines);
        let server = Process::start(&chrony("chronyd"), &arguments(&file), folder, &[]);
        let hosts = [&network.edge, &network.cloud];
        let clients = hosts.map(|host| follow(host, port, folder));
        for host in hosts {
            // Right after its first measurement chrony says that the clock's rate may be anything: until it is known to
            // 100 ppm, in tenths of a second.
            let until = ["-h", "127.0.0.1", "-p", COMMANDS, "waitsync", "600", "0", "100", "0.1"];
            host.run(&chrony("chronyc").display().to_string(), &until);
        }
        Self { _hosts: clients, _server: server }
    }

    /// The table of an agent that asks its host's chronyd and nobody else.
    pub fn table() -> String {
        let chronyc = chrony("chronyc").display().to_string();
        format!(
            "[clock]\ndiscipline = [\"chrony\"]\ndiscipline_interval_s = 0.5\nchronyc = \"{chronyc}\"\n\
             chronyc_arguments = [\"-h\", \"127.0.0.1\", \"-p\", \"{COMMANDS}\"]\n"
        )
    }
}

/// Starts the chronyd of a host.
fn follow(host: &Host, port: u16, folder: &Path) -> Process {
    let lines = format!(
        "server {} port {port} iburst minpoll -2 maxpoll 0\nport 0\ncmdport {COMMANDS}\nbindcmdaddress 127.0.0.1\n",
        host.home
    );
    let file = configuration(folder, &host.namespace, &lines);
    host.start(&chrony("chronyd"), &arguments(&file), folder, &[])
}

fn configuration(folder: &Path, name: &str, lines: &str) -> PathBuf {
    let file = folder.join(format!("{name}.chrony.conf"));
    let pid = file.with_extension("pid").display().to_string();
    std::fs::write(&file, format!("{lines}bindcmdaddress /\npidfile {pid}\n"))
        .expect("the temporary folder is writable");
    file
}

/// `-x` leaves the clock alone, `-d` logs to standard error.
fn arguments(file: &Path) -> Vec<String> {
    let file = file.display().to_string();
    ["-x", "-d", "-U", "-u", "root", "-f", &file].map(str::to_owned).into()
}
