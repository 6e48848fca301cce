//! A deployment on the loopback interface: a folder with configuration files, and ports.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::{Api, Process, free_port, program};

/// Folder and ports of one test's hosts.
#[derive(Debug)]
pub struct LoopbackDeployment {
    folder: TempDir,
    /// Port of the aggregator's event stream.
    pub events_port: u16,
    /// Port of the dashboard and API.
    pub http_port: u16,
    /// Port at which the cloud serves models.
    pub data_port: u16,
}

impl Default for LoopbackDeployment {
    fn default() -> Self {
        Self::new()
    }
}

impl LoopbackDeployment {
    /// Creates an empty deployment.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        Self { folder, events_port: free_port(), http_port: free_port(), data_port: free_port() }
    }

    /// Returns the folder of the deployment.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file into the folder; `{events}`, `{http}`, `{data}`, `{folder}` and `{root}` are replaced.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let text = text
            .replace("{events}", &self.events_port.to_string())
            .replace("{http}", &self.http_port.to_string())
            .replace("{data}", &self.data_port.to_string())
            .replace("{folder}", &self.folder().display().to_string())
            .replace("{root}", &crate::root().display().to_string());
        let path = self.folder().join(name);
        std::fs::write(&path, text).expect("the temporary folder is writable");
        path
    }

    /// Starts `peernetd run` with a configuration that was written as `name`.
    pub fn start(&self, name: &str) -> Process {
        self.start_with(name, &[])
    }

    /// Starts `peernetd run` with additional environment variables.
    pub fn start_with(&self, name: &str, environment: &[(&str, &str)]) -> Process {
        self.peernetd_with(&["run", name], environment)
    }

    /// Starts `peernetd` with these arguments in the folder.
    pub fn peernetd(&self, arguments: &[&str]) -> Process {
        self.peernetd_with(arguments, &[])
    }

    fn peernetd_with(&self, arguments: &[&str], environment: &[(&str, &str)]) -> Process {
        let library = crate::onnxruntime().join("libonnxruntime.so");
        let library = library.display().to_string();
        let environment: Vec<_> =
            environment.iter().copied().chain([("ORT_DYLIB_PATH", &*library)]).collect();
        Process::start(&program("peernetd"), arguments, self.folder(), &environment)
    }

    /// Writes the configuration of an agent that reports to the aggregator, and starts it; `tables` follow its table
    /// `[agent]`.
    pub fn start_agent(&self, name: &str, tables: &str) -> Process {
        let file = format!("{name}.toml");
        self.write(&file, &(agent_table(name, "127.0.0.1") + tables));
        self.start(&file)
    }

    /// Starts an aggregator with its dashboard, and waits until it answers.
    pub fn start_aggregator(&self) -> (Process, Api) {
        self.start_aggregator_at("127.0.0.1")
    }

    /// Starts an aggregator that listens for agents at this address.
    pub(crate) fn start_aggregator_at(&self, address: &str) -> (Process, Api) {
        let local_address = "127.0.0.1:{events}";
        self.write(
            "aggregator.toml",
            &AGGREGATOR.replace(local_address, &local_address.replace("127.0.0.1", address)),
        );
        let process = self.start("aggregator.toml");
        let api = Api::on_port(self.http_port);
        crate::wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
        (process, api)
    }
}

/// Returns the table `[agent]` of an agent that reaches its aggregator at an address, as a template for
/// [`LoopbackDeployment::write`].
pub(crate) fn agent_table(name: &str, aggregator: &str) -> String {
    format!(
        "[agent]\nname = \"{name}\"\nstate_dir = \"{{folder}}/{name}\"\n\
         aggregator = \"tcp://{aggregator}:{{events}}\"\n"
    )
}

/// Configuration of an aggregator with its dashboard, as a template for [`LoopbackDeployment::write`].
pub const AGGREGATOR: &str = r#"
[aggregator]
name = "aggregator"
listen = "tcp://127.0.0.1:{events}"
database = "{folder}/aggregator.sqlite"

[web]
listen = "127.0.0.1:{http}"
"#;
