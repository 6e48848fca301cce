//! A master of ROS 1 in a process of its own.

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

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
        let unused = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        Self::start_at(unused.expect("a port is free").port())
    }

    fn start_at(port: u16) -> Self {
        let process = Command::new("rosmaster")
            .args(["--core", "-p", &port.to_string()])
            .env("ROS_HOME", std::env::temp_dir())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("rosmaster is there: deploy/install-tools.sh test");
        let mut master = Self { process, port };
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            let ended = master.process.try_wait().expect("it is a child");
            assert!(ended.is_none(), "rosmaster ended: {ended:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
        master
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
