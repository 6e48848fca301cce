//! A folder with configuration files and ports of its own: one test's little plant.

use std::net::TcpListener;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::{Api, Process, program};

/// A port nobody listens on at the moment.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    listener.local_addr().expect("a bound socket has an address").port()
}

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
        self.peernetd(&["run", name])
    }

    /// Starts `peernetd` with given arguments in the site's folder.
    pub fn peernetd(&self, arguments: &[&str]) -> Process {
        let library = crate::onnxruntime().join("libonnxruntime.so");
        let library = library.display().to_string();
        Process::start(&program("peernetd"), arguments, self.folder(), &[("ORT_DYLIB_PATH", &library)])
    }

    /// Writes and starts an aggregator with its dashboard, and waits until it answers.
    pub fn aggregator(&self) -> (Process, Api) {
        self.write("aggregator.toml", AGGREGATOR);
        let process = self.start("aggregator.toml");
        let api = Api::at(self.http);
        crate::until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
        (process, api)
    }
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
