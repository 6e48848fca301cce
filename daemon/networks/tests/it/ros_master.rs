//! A master of ROS 1 in a process of its own.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

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
        Self::start_at(0)
    }

    fn start_at(port: u16) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/ros1/master.py");
        let mut process = Command::new("python3")
            .arg(script)
            .arg(port.to_string())
            // It ends when its input does.
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("python3 is there");
        let mut line = String::new();
        let output = process.stdout.take().expect("piped");
        BufReader::new(output).read_line(&mut line).expect("it says that it is ready");
        let port = line.trim().strip_prefix("ready ").and_then(|port| port.parse().ok()).expect("its port");
        Self { process, port }
    }

    /// Kills it, and starts one at the same port that knows nothing.
    pub(crate) fn restart(&mut self) {
        self.kill();
        *self = Self::start_at(self.port);
    }

    pub(crate) fn kill(&mut self) {
        self.process.kill().expect("it runs");
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
        // It may have been killed.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
