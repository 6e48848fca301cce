//! Experiments: a matrix of runs from one file, with a cloud that runs all the time.

mod failing;
mod files;
mod resumed;
mod same_seed;
mod users;

use std::path::{Path, PathBuf};

use peernet_tests::{Process, Site, onnxruntime, program, root, until};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

const CLOUD: &str = r#"
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "quality-control"
kind = "onnx"
path = "{root}/models/quality-control"

[[model]]
name = "echo"
kind = "echo"

[[model]]
name = "slow"
kind = "sleep"
preprocessing_ms = 0
inference_ms = 40
postprocessing_ms = 0
"#;

/// Three runs; the second takes ten seconds, so that there is time to end it.
const THREE: &str = r#"
[experiment]
name = "three"
order = "declared"
iterations = 25
warm_up = { iterations = 2 }

[pipeline]
sensor = { kind = "synthetic" }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "slow" }

[[axis]]
name = "Size"

[[axis.value]]
label = "100"
set = { "pipeline.sensor.size_bytes" = 100 }

[[axis.value]]
label = "200"
set = { "pipeline.sensor.size_bytes" = 200, "experiment.iterations" = 250 }

[[axis.value]]
label = "300"
set = { "pipeline.sensor.size_bytes" = 300 }
"#;

/// A cloud, and a folder for experiments.
struct Lab {
    site: Site,
    _cloud: Process,
}

impl Lab {
    fn new() -> Self {
        let site = Site::new();
        site.write("cloud.toml", CLOUD);
        let cloud = site.start("cloud.toml");
        cloud.wait_for("ready");
        Self { site, _cloud: cloud }
    }

    /// The folder with an experiment's results.
    fn results(&self) -> PathBuf {
        self.site.folder().join("results")
    }

    /// Starts `peernet run` on a text.
    fn run(&self, text: &str, options: &[&str]) -> Process {
        let file = self.site.write("experiment.toml", text);
        let results = self.results();
        let mut arguments = vec![Path::new("run"), &file, Path::new("--result-loc"), &results];
        arguments.extend(options.iter().map(Path::new));
        let library = onnxruntime().join("libonnxruntime.so").display().to_string();
        Process::start(&program("peernet"), &arguments, root(), &[("ORT_DYLIB_PATH", &library)])
    }

    /// What is written down of the experiment.
    fn record(&self) -> Value {
        json(&self.results().join("experiment.json"))
    }

    /// The folders of the runs, in their order.
    fn folders(&self) -> Vec<String> {
        let record = self.record();
        let runs = record["plan"]["runs"].as_array().expect("a list").iter();
        runs.map(|run| run["folder"].as_str().expect("a name").to_owned()).collect()
    }

    /// What became of the runs, in their order.
    fn stages(&self) -> Vec<String> {
        let record = self.record();
        let states = record["states"].as_array().expect("a list").iter();
        states.map(|state| state["stage"].as_str().expect("a word").to_owned()).collect()
    }

    /// A run's file.
    fn file(&self, folder: &str, name: &str) -> PathBuf {
        self.results().join("runs").join(folder).join(name)
    }

    /// Waits until so many rows of a run are in its file.
    fn rows(&self, folder: &str, count: usize) {
        let path = self.file(folder, "data.csv");
        until("rows", || {
            let text = std::fs::read_to_string(&path).ok()?;
            (text.lines().count() > count).then_some(())
        });
    }
}

/// A column of a run's rows.
fn column(path: &Path, name: &str) -> Vec<String> {
    let mut reader = csv::Reader::from_path(path).expect("there are rows");
    let at =
        reader.headers().expect("a header").iter().position(|column| column == name).expect("the column");
    reader.records().map(|row| row.expect("a row")[at].to_owned()).collect()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("it was written")).expect("it is JSON")
}

/// The processes that a program has started and not waited for.
fn children(process: &Process) -> Vec<Pid> {
    let pid = process.pid();
    let text = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).expect("it runs");
    text.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)).collect()
}

fn kill(pid: Pid) {
    kill_process(pid, Signal::KILL).expect("it runs");
}
