//! `peernet --client`: senses, sends samples to the server, writes the results.

use std::path::PathBuf;

use crate::clock;
use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::Context;
use peernet_agent::config::{HostConfig, PipelineConfig};
use peernet_analysis::summary::Summary;
use peernet_clock::ClockIdentity;
use peernet_external::exec::with_arguments;
use peernet_networks::{Address, SessionSettings};
use peernet_results::{Overwrite, summary};
use peernet_sample::printable_line;
use serde_json::json;

use super::client_progress::ClientProgress;
use super::devices::Devices;
use super::{Arguments, sensor};
use crate::foreground::{command_line, dashboard_hint, read_agent_tables};
use crate::measure::{AgentStateDir, MeasuredRun, RunRequest, measure, undelivered};

/// Number of iterations at the start of a run that the plots of the paper's program leave out.
const WARM_UP_ITERATIONS: u64 = 5;
/// Longest wait for an answer in milliseconds unless `--timeout` sets another: the largest model on a slow processor
/// takes long. It is longer than the server's limit for one call of a model (60 s), because the server's error says
/// more.
const TIMEOUT_MS: u64 = 75_000;
/// Timeout of connecting in milliseconds, in which the server may load its model.
const OPEN_TIMEOUT_MS: u64 = 60_000;
/// Default folder for results.
const DEFAULT_RESULTS_DIR: &str = "results";

/// Measures and writes the results.
///
/// # Errors
/// Those of [`measure`]. Also when the data set does not exist (exit code 66), some iterations failed (exit code 75),
/// or the user ended the run early (exit code 130).
pub(super) fn run(arguments: &Arguments, devices: &Devices) -> Result<(), Failure> {
    let request = run_request(arguments, devices)?;
    let clock =
        clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let measured = measure(&request, &mut ClientProgress::new(arguments.quiet, clock))?;
    print_results(&measured);
    if let Some(aggregator) = &arguments.aggregator {
        print_streaming_state(&request.agent.agent, arguments, aggregator)?;
    }
    measured.failure().map_or(Ok(()), Err)
}

/// Returns the request to measure the run that the arguments describe.
fn run_request(arguments: &Arguments, devices: &Devices) -> Result<RunRequest, Failure> {
    let (sensor, transforms) = sensor::from_arguments(arguments)?;
    let session = arguments.session(SessionSettings {
        // A model that is slow to answer may also be slow to load.
        open_timeout_ms: OPEN_TIMEOUT_MS.max(arguments.timeout_ms().unwrap_or(0)),
        ros2: devices.ros2.clone(),
        ..SessionSettings::default()
    });
    let pipeline = || {
        json!({
            "name": arguments.name,
            "sensor": sensor,
            "transforms": transforms,
            "placement": {
                "kind": "remote",
                "peer": devices.server_address,
                "session": session,
            },
            "load": { "mode": "closed" },
            "timeout_ms": arguments.timeout_ms().unwrap_or(TIMEOUT_MS),
            "warm_up": { "iterations": WARM_UP_ITERATIONS },
            "limit": { "total": arguments.iterations },
        })
    };
    // Without `with_arguments`, the program of a sensor would lose its arguments.
    let pipeline: PipelineConfig = serde_json::from_value(with_arguments(pipeline))
        .context("cannot set up the pipeline")
        .map_err(|error| Failure::new(Exit::Software, error))?;
    let mut agent = read_agent_tables(arguments.config.as_deref())?;
    agent.agent.name = Some(arguments.name.clone());
    agent.agent.aggregator.clone_from(&arguments.aggregator);
    agent.pipelines = vec![pipeline];
    let (folder, overwrite) = match (&arguments.result_loc, arguments.overwrite) {
        (folder, true) => (folder.clone(), Overwrite::Replace),
        (Some(folder), false) => (Some(folder.clone()), Overwrite::Refuse),
        (None, false) => (None, Overwrite::Subfolder),
    };
    Ok(RunRequest {
        agent,
        title: format!("{} → {}, {}", arguments.name, devices.server, devices.server_address.network()),
        folder: folder.unwrap_or_else(|| PathBuf::from(DEFAULT_RESULTS_DIR)),
        overwrite,
        plots: arguments.generate_plots,
        command: command_line(),
        network_config: Some(devices.config.clone()),
        user: None,
        warm_up: format!("the first {WARM_UP_ITERATIONS} iterations"),
        peer_timeout_s: Some(arguments.patience),
        tried_actuator: None,
    })
}

/// Prints the results, their folder and their files.
fn print_results(measured: &MeasuredRun) {
    print_to_stdout(summary::text(&Summary::from_run(&measured.record, &measured.rows)));
    if let Some(trust) = &measured.record.trust {
        print_to_stdout(format_args!("\n{}", trust.text()));
    }
    let files: Vec<_> = measured.files.iter().filter_map(|path| path.file_name()?.to_str()).collect();
    let folder = measured.folder.display().to_string();
    print_to_stdout(format_args!("\n{}: {}", printable_line(&folder), files.join(", ")));
}

/// Prints where the streamed run can be seen, and the numbers of events that still wait for an
/// aggregator. Events of earlier runs of this host may be among them.
fn print_streaming_state(
    agent: &HostConfig,
    arguments: &Arguments,
    aggregator: &Address,
) -> Result<(), Failure> {
    let state_dir = AgentStateDir::for_agent(agent)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime
        .context("cannot start the runtime")
        .map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let undelivered = runtime.block_on(undelivered(state_dir.folder()));
    let name = &arguments.name;
    let is_delivered = !undelivered.iter().any(|events| events.is_for(aggregator));
    print_to_stdout(dashboard_hint(format_args!("host {name}, pipeline {name},"), aggregator, is_delivered));
    undelivered.iter().for_each(print_to_stderr);
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use peernet_sensors::SensorConfig;

    use super::*;
    use crate::Cli;

    #[test]
    fn sensor_program_keeps_its_arguments() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("net.yaml");
        let devices = "devices: { edge: 127.0.0.1, cluster: 127.0.0.1 }\nserver: cluster\n";
        std::fs::write(&file, devices).expect("written");
        let line = format!(
            "peernet --client --name edge --iterations 7 --network-config {} --sensor-object exec:cat",
            file.display()
        );
        // The command has a space, so the command is completed after the line is split at spaces.
        let words = line.split(' ').map(|word| word.replace("exec:cat", "exec:cat -u"));
        let arguments = Cli::try_parse_from(words).expect("a command line of the paper").paper;
        let arguments = arguments.expect("its options are at the top level");
        let devices = Devices::read(&arguments.network_config, None).expect("a file of devices");
        let request = run_request(&arguments, &devices).expect("a pipeline");
        assert_eq!(request.agent.pipelines[0].sensor, Some(SensorConfig::program("cat -u")));
    }
}
