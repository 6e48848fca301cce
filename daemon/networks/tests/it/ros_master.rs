//! A master of ROS 1 in a process of its own.

use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use peernet_test_ports::free_port;

use crate::support::next_number;

/// A master, which ends with this value or with this process.
#[derive(Debug)]
pub(crate) struct RosMaster {
    process: Child,
    port: u16,
}

impl RosMaster {
    /// A master for all tests that leave it alone.
    pub(crate) fn shared() -> &'static Self {
        static SHARED: OnceLock<RosMaster> = OnceLock::new();
        SHARED.get_or_init(Self::start)
    }

    pub(crate) fn start() -> Self {
        Self::start_at(free_port())
    }

    fn start_at(port: u16) -> Self {
        // The shell ends it when its own input does: with this process, whatever ends that.
        let process = Command::new("sh")
            .args(["-c", "rosmaster --core -p \"$0\" & read -r _; kill -9 $!; wait", &port.to_string()])
            .env("ROS_HOME", std::env::temp_dir())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("there is a shell");
        let mut tries = 0;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            tries += 1;
            assert!(tries < 1_500, "no rosmaster after 30 s: deploy/install-tools.sh test");
            std::thread::sleep(Duration::from_millis(20));
        }
        Self { process, port }
    }

    /// Kills it, and starts one at the same port that knows nothing.
    pub(crate) fn restart(&mut self) {
        self.kill();
        *self = Self::start_at(self.port);
    }

    pub(crate) fn kill(&mut self) {
        drop(self.process.stdin.take());
        self.process.wait().expect("it is a child");
    }

    /// A name that no other cloud has.
    pub(crate) fn address(&self) -> String {
        format!("ros1://127.0.0.1:{}/cloud{}", self.port, next_number())
    }

    pub(crate) fn uri(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }
}

impl Drop for RosMaster {
    fn drop(&mut self) {
        drop(self.process.stdin.take());
        // Nobody is left to tell.
        let _ = self.process.wait();
    }
}
