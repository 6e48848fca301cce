//! A ROS 1 master in a separate process.

use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use peernet_test_ports::free_port;
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};

use crate::support::next_number;

/// A master. It ends when this value is dropped, or when this process ends.
#[derive(Debug)]
pub(crate) struct RosMaster {
    process: Child,
    port: u16,
}

impl RosMaster {
    /// Returns a master for all tests that do not stop it.
    pub(crate) fn shared() -> &'static Self {
        static SHARED: OnceLock<RosMaster> = OnceLock::new();
        SHARED.get_or_init(Self::start)
    }

    pub(crate) fn start() -> Self {
        Self::start_at(free_port())
    }

    fn start_at(port: u16) -> Self {
        // The shell ends the master when the shell's input closes. The input closes whenever and however this process
        // ends.
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
            assert!(
                tries < 1_500,
                "no rosmaster answers after 30 s; install it with deploy/install-tools.sh test"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
        Self { process, port }
    }

    /// Kills the master, and starts a new one without state at the same port.
    pub(crate) fn restart(&mut self) {
        self.kill();
        *self = Self::start_at(self.port);
    }

    pub(crate) fn kill(&mut self) {
        drop(self.process.stdin.take());
        self.process.wait().expect("the shell is a child of this process");
    }

    /// Returns an address with a name that no other cloud has.
    pub(crate) fn address(&self) -> String {
        format!("ros1://127.0.0.1:{}/cloud{}", self.port, next_number())
    }

    pub(crate) fn uri(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Starts a relay to the master, and returns its address. The relay closes the connection of each call of `method`
    /// without an answer. The relay ends with the test's runtime.
    pub(crate) async fn relay_without(&self, method: &str) -> SocketAddr {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound");
        let (port, blocked_method) = (self.port, format!("<methodName>{method}</methodName>"));
        tokio::spawn(async move {
            loop {
                let (mut node, _) = listener.accept().await.expect("a connection");
                let blocked_method = blocked_method.clone();
                tokio::spawn(async move {
                    let mut call = Vec::new();
                    while !String::from_utf8_lossy(&call).contains("</methodCall>") {
                        let length = node.read_buf(&mut call).await.expect("a call");
                        assert!(length > 0, "the call is complete");
                    }
                    if String::from_utf8_lossy(&call).contains(&blocked_method) {
                        return;
                    }
                    let master = tokio::net::TcpStream::connect(("127.0.0.1", port)).await;
                    let mut master = master.expect("the master runs");
                    master.write_all(&call).await.expect("the master reads");
                    // The node closes its connection as soon as it has the answer, which may be an error here.
                    let _ = copy_bidirectional(&mut node, &mut master).await;
                });
            }
        });
        address
    }
}

impl Drop for RosMaster {
    fn drop(&mut self) {
        drop(self.process.stdin.take());
        // Waiting fails if the process has already been waited for.
        let _ = self.process.wait();
    }
}
