//! A folder with configuration files and ports of its own: one test's little plant.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::{Api, Process, free_port, program};

/// Where one test's hosts live.
#[derive(Debug)]
pub struct Site {
    folder: TempDir,
    /// Port of the aggregator's event stream.
    pub events: u16,
    /// Port of the dashboard and API.
    pub http: u16,
    /// Port at which the cloud serves models.
    pub data: u16,
}

impl Default for Site {
    fn default() -> Self {
        Self::new()
    }
}

impl Site {
    /// An empty site.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        Self { folder, events: free_port(), http: free_port(), data: free_port() }
    }

    /// The site's folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file into the site's folder; `{events}`, `{http}`, `{data}`, `{folder}` and `{root}` are filled in.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let text = text
            .replace("{events}", &self.events.to_string())
            .replace("{http}", &self.http.to_string())
            .replace("{data}", &self.data.to_string())
            .replace("{folder}", &self.folder().display().to_string())
            .replace("{root}", &crate::root().display().to_string());
        let path = self.folder().join(name);
        std::fs::write(&path, text).expect("the temporary folder is writable");
        path
    }

    /// Starts `peernetd run` on a configuration that was written under `name` before.
    pub fn start(&self, name: &str) -> Process {
        self.start_with(name, &[])
    }

    /// The same with further environment variables.
    pub fn start_with(&self, name: &str, environment: &[(&str, &str)]) -> Process {
        self.peernetd_with(&["run", name], environment)
    }

    /// Starts `peernetd` with given arguments in the site's folder.
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

    /// Writes and starts an agent that reports to the site's aggregator; `tables` follow its table `[agent]`.
    pub fn agent(&self, name: &str, tables: &str) -> Process {
        let file = format!("{name}.toml");
        self.write(&file, &(agent(name, "127.0.0.1") + tables));
        self.start(&file)
    }

    /// Writes and starts an aggregator with its dashboard, and waits until it answers.
    pub fn aggregator(&self) -> (Process, Api) {
        self.aggregator_for("127.0.0.1")
    }

    /// The same for agents that reach it at an address.
    pub(crate) fn aggregator_for(&self, address: &str) -> (Process, Api) {
        let events = "127.0.0.1:{events}";
        self.write("aggregator.toml", &AGGREGATOR.replace(events, &events.replace("127.0.0.1", address)));
        let process = self.start("aggregator.toml");
        let api = Api::at(self.http);
        crate::until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
        (process, api)
    }
}

/// The table `[agent]` of an agent that reaches its aggregator at an address, as [`Site::write`] takes it.
pub(crate) fn agent(name: &str, aggregator: &str) -> String {
    format!(
        "[agent]\nname = \"{name}\"\nstate_dir = \"{{folder}}/{name}\"\n\
         aggregator = \"tcp://{aggregator}:{{events}}\"\n"
    )
}

/// An aggregator with its dashboard, as [`Site::write`] takes it.
pub const AGGREGATOR: &str = r#"
[aggregator]
name = "aggregator"
listen = "tcp://127.0.0.1:{events}"
database = "{folder}/aggregator.sqlite"

[web]
listen = "127.0.0.1:{http}"
"#;
