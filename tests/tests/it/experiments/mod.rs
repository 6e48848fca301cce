//! Tests of experiments: a matrix of runs from one file on one machine, with a cloud on another.

mod cloud_gone;
mod custom_objects;
mod failing;
mod files;
mod printed;
mod repeated;
mod results;
mod resumed;
pub(crate) mod same_seed;
pub(crate) mod users;

use std::ffi::OsStr;
use std::path::Path;

use peernet_tests::{LoopbackDeployment, Network, Process, ProcessEnd, program, root};
use rustix::process::{Pid, Signal, kill_process};

pub(crate) use results::{Results, column, json};

const CLOUD: &str = r#"
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[serve]
listen = "tcp://0.0.0.0:5551"

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

/// Experiment of three runs. The second run takes ten seconds, so that a test can act during this
/// run.
const THREE_RUNS: &str = r#"
[experiment]
name = "three"
order = "declared"
iterations = 25
warm_up = { iterations = 2 }

[pipeline]
sensor = { kind = "synthetic" }
placement = { kind = "remote", peer = "{cloud}", model = "slow" }

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

/// An edge and a cloud at the two ends of a cable, and a folder for experiments.
struct Lab {
    results: Results,
    cloud: Option<Process>,
    deployment: LoopbackDeployment,
    network: Network,
}

impl Lab {
    fn new() -> Self {
        let (deployment, network) = (LoopbackDeployment::new(), Network::direct());
        let mut lab = Self {
            results: Results::of(deployment.folder().join("results")),
            cloud: None,
            deployment,
            network,
        };
        lab.deployment.write("cloud.toml", CLOUD);
        lab.start_cloud();
        lab
    }

    fn start_cloud(&mut self) {
        let arguments = ["run", "cloud.toml"];
        let cloud =
            self.network.cloud().start(&program("peernetd"), &arguments, self.deployment.folder(), &[]);
        cloud.wait_for("ready");
        self.cloud = Some(cloud);
    }

    /// Suspends the cloud's process, so that it does not answer.
    fn suspend_cloud(&self) {
        self.cloud.as_ref().expect("it runs").signal(Signal::STOP);
    }

    fn kill_cloud(&mut self) {
        self.cloud.take().expect("it runs").kill();
    }

    /// Starts `peernet run` with a text, in which `{cloud}` stands for the address of the cloud.
    fn run(&self, text: &str, options: &[&str]) -> Process {
        let peer = format!("tcp://{}:5551", self.network.cloud().address);
        let file = self.deployment.write("experiment.toml", &text.replace("{cloud}", &peer));
        let mut arguments = vec![Path::new("run"), &file, Path::new("--result-loc"), &self.results.folder];
        arguments.extend(options.iter().map(Path::new));
        self.network.edge().start(&program("peernet"), &arguments, root(), &[])
    }
}

/// Runs a command on results and returns its output.
fn run_command(command: &str, results: &Path) -> ProcessEnd {
    let arguments = [OsStr::new(command), results.as_os_str()];
    Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end()
}

/// Waits for the end of an experiment. The timeout starts again with each run, so a long experiment does not exceed it.
pub(crate) fn wait_for_runs(experiment: Process, runs: usize) -> ProcessEnd {
    for run in 1..=runs {
        experiment.wait_for(&format!("run {run} of {runs} ("));
    }
    experiment.wait_for_end()
}

/// Returns the children of a program that it has not waited for.
fn children(process: &Process) -> Vec<Pid> {
    let pid = process.pid();
    let text = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).expect("it runs");
    text.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)).collect()
}

fn kill(pid: Pid) {
    kill_process(pid, Signal::KILL).expect("it runs");
}
