//! Tests of the paper's commands, as the paper shows them.

mod commands;
mod datagrams;
mod ended;
mod limits;
mod objects;
mod refused;
mod ros;
mod streamed;

use std::path::{Path, PathBuf};

use peernet_tests::network::Host;
use peernet_tests::{Network, Process, free_port, onnxruntime, program, root};
use serde_json::Value;
use tempfile::TempDir;

/// Columns that the paper's program writes for a model with all three steps, in its order.
const PUBLISHED_COLUMNS: [&str; 13] = [
    "iteration",
    "sensing",
    "upload",
    "preprocessing",
    "inference",
    "postprocessing",
    "download",
    "download-bytes",
    "download-logger-bytes",
    "upload-bytes",
    "upload-logger-bytes",
    "upload-throughput",
    "download-throughput",
];

/// Two devices with one network configuration, and the program with its published name.
struct Lab {
    folder: TempDir,
    /// Two machines; `None` if both devices are this machine.
    network: Option<Network>,
    /// URI of the ROS master.
    ros_master: Option<String>,
}

impl Lab {
    /// Creates two machines and a cable.
    fn new() -> Self {
        Self::with_network(Network::direct())
    }

    /// Creates two machines with this network.
    fn with_network(network: Network) -> Self {
        let (edge, cloud) = (network.edge().address.to_string(), network.cloud().address.to_string());
        Self::with_configuration(
            Some(network),
            &format!("devices:\n  jetson-orin: {edge}\n  cluster: {cloud}\nserver: cluster\n"),
        )
    }

    /// Creates one machine.
    fn on_one_machine() -> Self {
        let devices = "  jetson-orin: 127.0.0.1\n  cluster: 127.0.0.1\n  spare: 127.0.0.1\n";
        Self::with_configuration(
            None,
            &format!("devices:\n{devices}server: cluster\nstart_port: {}\n", free_port()),
        )
    }

    fn with_configuration(network: Option<Network>, configuration: &str) -> Self {
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        std::fs::write(folder.path().join("net_config.yaml"), configuration).expect("writable");
        let published = folder.path().join("PEERNet");
        std::os::unix::fs::symlink(program("peernet"), published).expect("writable");
        Self { folder, network, ros_master: None }
    }

    fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Executes a command on the device that serves.
    fn start_server(&self, command: &str) -> Process {
        self.start(self.network.as_ref().map(Network::cloud), command)
    }

    /// Executes a command on the device that senses.
    fn start_client(&self, command: &str) -> Process {
        self.start(self.network.as_ref().map(Network::edge), command)
    }

    fn start(&self, host: Option<&Host>, command: &str) -> Process {
        let mut words = split_words(command).into_iter();
        assert_eq!(words.next().as_deref(), Some("PEERNet"), "{command}");
        let arguments: Vec<String> = words.collect();
        let (program, folder) = (self.folder().join("PEERNet"), self.folder());
        let library = onnxruntime().join("libonnxruntime.so").display().to_string();
        let state = self.folder().join("state").display().to_string();
        let mut environment = vec![
            ("ORT_DYLIB_PATH", &*library),
            ("PEERNET_PYTHON", "/usr/bin/python3"),
            // The tests must not leave files in the home folder of the user.
            ("XDG_STATE_HOME", &*state),
        ];
        environment.extend(self.ros_master.as_deref().map(|uri| ("ROS_MASTER_URI", uri)));
        match host {
            Some(host) => host.start(&program, &arguments, folder, &environment),
            None => Process::start(&program, &arguments, folder, &environment),
        }
    }

    /// Reads `data.csv` of a result folder as text.
    fn data(&self, results: &str) -> Data {
        let file = csv::Reader::from_path(self.folder().join(results).join("data.csv"));
        let mut file = file.expect("the results are there");
        let cells = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect();
        let header = cells(file.headers().expect("there is a header"));
        let rows = file.records().map(|row| cells(&row.expect("as many cells as the header")));
        Data { header, rows: rows.collect() }
    }

    fn record(&self, results: &str) -> Value {
        let file = self.folder().join(results).join("run.json");
        serde_json::from_slice(&std::fs::read(file).expect("it was written")).expect("it is JSON")
    }
}

/// Splits a command into words; quotes join several words.
fn split_words(command: &str) -> Vec<String> {
    let parts = command.split('"').enumerate();
    parts
        .flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect(),
            _ => vec![part.to_owned()],
        })
        .collect()
}

/// Table of results.
struct Data {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Data {
    fn column(&self, name: &str) -> Vec<&str> {
        let index = self.header.iter().position(|column| column == name);
        let index = index.unwrap_or_else(|| panic!("no column {name} in {:?}", self.header));
        self.rows.iter().map(|row| row[index].as_str()).collect()
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        let number = |cell: &str| cell.parse().unwrap_or_else(|_| panic!("{cell:?} in {name} is no number"));
        self.column(name).into_iter().map(number).collect()
    }

    fn count_outcome(&self, outcome: &str) -> usize {
        self.column("outcome").into_iter().filter(|cell| *cell == outcome).count()
    }
}

/// Returns the path of a picture.
fn picture() -> PathBuf {
    root().join("models/quality-control/pictures/part-0001.jpg")
}
