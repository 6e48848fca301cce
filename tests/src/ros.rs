//! A ROS 1 system of real processes: a master, and nodes with a known delay.

use std::net::TcpStream;
use std::path::Path;

use crate::{LoopbackDeployment, Process, free_port, program, root, wait_until};

/// ROS 1 system on the loopback interface.
#[derive(Debug)]
pub struct Ros1System {
    port: u16,
    master: Option<Process>,
}

impl Default for Ros1System {
    fn default() -> Self {
        Self::new()
    }
}

impl Ros1System {
    /// Starts a master.
    pub fn new() -> Self {
        let mut system = Self { port: free_port(), master: None };
        system.start_master();
        system
    }

    /// Starts the master at the system's port, which does not change.
    pub fn start_master(&mut self) {
        let arguments = ["--core", "-p", &self.port.to_string()];
        let home = std::env::temp_dir().display().to_string();
        self.master =
            Some(Process::start(Path::new("rosmaster"), &arguments, root(), &[("ROS_HOME", &home)]));
        wait_until("the ROS master", || TcpStream::connect(("127.0.0.1", self.port)).ok());
    }

    /// Kills the master, which loses its state.
    pub fn kill_master(&mut self) {
        self.master.take().map(Process::kill);
    }

    /// Returns the URI of the master.
    pub fn uri(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Returns the port of the master.
    pub const fn port(&self) -> u16 {
        self.port
    }

    /// Returns the environment variables of programs that belong to the system.
    pub fn environment(&self) -> [(&'static str, String); 2] {
        [("ROS_MASTER_URI", self.uri()), ("ROS_IP", "127.0.0.1".to_owned())]
    }

    /// Starts a node of `tests/ros/node.rs` and waits until the master knows its topics.
    pub fn start_node(&self, arguments: &[&str]) -> Process {
        let environment = self.environment();
        let environment: Vec<(&str, &str)> =
            environment.iter().map(|(name, value)| (*name, value.as_str())).collect();
        let node = Process::start(&program("ros1-node"), arguments, root(), &environment);
        node.wait_for("ready");
        node
    }

    /// Writes the configuration of an agent and starts it as a part of the system; `tables` follow its table
    /// `[agent]`.
    pub fn start_agent(&self, deployment: &LoopbackDeployment, name: &str, tables: &str) -> Process {
        let file = format!("{name}.toml");
        deployment.write(&file, &(crate::loopback_deployment::agent_table(name, "127.0.0.1") + tables));
        let environment = self.environment();
        let environment: Vec<(&str, &str)> =
            environment.iter().map(|(name, value)| (*name, value.as_str())).collect();
        deployment.start_with(&file, &environment)
    }
}
