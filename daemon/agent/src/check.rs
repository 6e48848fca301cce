//! Checks a configuration before the agent starts.

mod spool;
mod time;

use std::collections::HashSet;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_actuators::ActuatorKind;
use peernet_clock::SharedClock;
use peernet_external::process::MAX_TIMEOUT_MS;
use peernet_inference::bank::ModelFolders;
use peernet_inference::{Bank, LoadError, check_library};
use peernet_logger::Slug;
use peernet_networks::{Address, MAX_IN_FLIGHT, NetworkKind, SessionSettings};
use peernet_ros::topics::check_name;
use peernet_sensors::{SensorKind, TransformKind};
use peernet_stream::limits::MAX_PIPELINES;
use rustix::fs::{Access, access};

use crate::config::{
    AgentConfig, HostConfig, LoadConfig, ObserveConfig, PipelineConfig, PlacementConfig, ServeConfig,
};
use crate::identity::{existing_id, existing_secret};

/// Largest `agent.queue_events`.
const MAX_QUEUE_EVENTS: u64 = 10_000_000;
/// Largest `agent.queue_bytes`: 16 GiB.
const MAX_QUEUE_BYTES: u64 = 16 << 30;
/// Largest `agent.batch_nodes`.
const MAX_BATCH_NODES: u64 = 1_000_000;
/// Largest `agent.batch_bytes`: 2 MiB, well below the largest message that the aggregator accepts.
const MAX_BATCH_BYTES: u64 = 2 << 20;
/// Largest `agent.batch_delay_ms`: a minute.
const MAX_BATCH_DELAY_MS: u64 = 60_000;
/// Largest `agent.io_threads`.
const MAX_IO_THREADS: u64 = 64;
/// Largest `agent.stop_timeout_ms`: a minute.
const MAX_STOP_TIMEOUT_MS: u64 = 60_000;
/// Largest `limit.duration_s`, and longest interval between two starts of iterations: a year.
const MAX_RUN_S: f64 = 365.0 * 86_400.0;

/// A problem with one key of a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Path of the key, such as `pipeline[1].placement.model`; indices count from 0.
    pub key: String,
    /// Text that says what is wrong, and what to do.
    pub text: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.key, self.text)
    }
}

/// The problems found so far.
#[derive(Default)]
struct Report(Vec<Problem>);

impl Report {
    /// Adds a problem.
    fn add(&mut self, key: impl Into<String>, text: impl fmt::Display) {
        self.0.push(Problem { key: key.into(), text: text.to_string() });
    }

    /// Adds a problem if the result is an error.
    fn check_result<T>(&mut self, key: impl Into<String>, result: Result<T, impl fmt::Display>) {
        if let Err(error) = result {
            self.add(key, error);
        }
    }

    /// Adds a problem if a value is above `max`.
    fn check_max(&mut self, key: &str, value: u64, max: u64) {
        if value > max {
            self.add(key, format!("{value} is too large; at most {max}"));
        }
    }

    /// Checks the settings of sessions.
    fn check_session_settings(&mut self, key: &str, settings: &SessionSettings) {
        if let Err(error) = settings.check() {
            self.add(format!("{key}.{}", error.key), format!("{} {}", error.value, error.problem));
        }
        // A value that at least one network refuses is reported, even if the configuration does not use that network.
        for network in NetworkKind::ALL {
            if let Err(error) = network.check_settings(settings) {
                self.add(format!("{key}.{}", error.key), error.problem);
            }
        }
    }
}

/// Checks a configuration. Reads files and binds the ports for a moment, but changes nothing. Blocks.
pub(crate) fn check(config: &AgentConfig, clock: &SharedClock) -> Vec<Problem> {
    let mut report = Report::default();
    report.check_result("agent.name", config.agent.host_name());
    report.check_result("agent.state_dir", check_writable(&config.agent.state_dir, "state_dir"));
    report.check_result("agent.state_dir", existing_id(&config.agent.state_dir));
    report.check_result("agent.state_dir", existing_secret(&config.agent.state_dir));
    if let Some(aggregator) = &config.agent.aggregator {
        report.check_result("agent.aggregator", aggregator.check_event_stream());
    }
    check_host(&mut report, &config.agent);
    spool::check_spool(&mut report, config);
    let bank = Bank::new(config.models.clone(), config.onnxruntime.clone(), Arc::clone(clock));
    let bank = bank.with_folders(config.bank.clone());
    for (index, error) in bank.check() {
        let key = match &error {
            LoadError::AboveLimit { key, .. } | LoadError::InvalidKey { key, .. } => {
                format!("model[{index}].{key}")
            }
            _ => format!("model[{index}]"),
        };
        report.add(key, error);
    }
    for (key, error) in bank.check_folders() {
        report.add(format!("bank.{key}"), error);
    }
    let models = bank.offered_names();
    if let Some(serve) = &config.serve {
        let observes = |pipeline: &PipelineConfig| matches!(pipeline.placement, PlacementConfig::Observe(_));
        // A host without models may still serve: peers can query the stamps of the messages that its pipelines observe.
        let has_stamps = config.pipelines.iter().any(observes);
        check_serve(&mut report, serve, models.is_empty() && !has_stamps);
    }
    time::check_clock(&mut report, &config.clock);
    time::check_probes(&mut report, &config.probes, config.serve.as_ref());
    if let Some(clock_fault) = &config.clock_fault {
        time::check_clock_fault(&mut report, clock_fault);
    }
    report.check_max("pipeline", config.pipelines.len() as u64, MAX_PIPELINES as u64);
    let mut names = HashSet::new();
    for (index, pipeline) in config.pipelines.iter().enumerate() {
        let prefix = format!("pipeline[{index}]");
        // Runs, live state and topics are identified by the pipeline's name.
        if !names.insert(&pipeline.name) {
            let text = format!("another pipeline is named {}, too; choose another name", pipeline.name);
            report.add(format!("{prefix}.name"), text);
        }
        check_pipeline(&mut report, &prefix, pipeline, (&models, &config.bank.folders), clock);
    }
    report.0
}

/// Returns remarks about valid settings that may have unexpected effects. May block for some seconds, because some
/// sensors and actuators query other hosts.
pub(crate) fn remarks(config: &AgentConfig, clock: &SharedClock) -> Vec<Problem> {
    let mut report = Report::default();
    // This is a remark and not an error, because the library is needed only when a model of [bank] is requested.
    let folders = ModelFolders::new(config.bank.folders.iter().cloned());
    let has_loadable_model = || folders.list().iter().any(|model| model.card.is_ok());
    if !config.bank.devices.is_empty()
        && has_loadable_model()
        && let Err(error) = check_library(&config.onnxruntime, clock)
    {
        report.add("onnxruntime", format!("the models of [bank] cannot be loaded: {error}"));
    }
    for (index, pipeline) in config.pipelines.iter().enumerate() {
        let warm_up = pipeline.warm_up.iterations;
        if let Some(total) = pipeline.limit.total.filter(|total| total.get() <= warm_up) {
            let text = format!(
                "all {total} iterations are warm-up (warm_up.iterations = {warm_up}): the run will have rows, but no statistics"
            );
            report.add(format!("pipeline[{index}].limit.total"), text);
        }
        for remark in pipeline.sensor.iter().flat_map(SensorKind::remarks) {
            report.add(format!("pipeline[{index}].sensor"), remark);
        }
        for remark in pipeline.actuator.remarks(clock) {
            report.add(format!("pipeline[{index}].actuator"), remark);
        }
    }
    report.0
}

fn check_host(report: &mut Report, host: &HostConfig) {
    report.check_max("agent.io_threads", host.io_threads.get() as u64, MAX_IO_THREADS);
    report.check_max("agent.queue_events", host.queue_events.get() as u64, MAX_QUEUE_EVENTS);
    report.check_max("agent.queue_bytes", host.queue_bytes.get() as u64, MAX_QUEUE_BYTES);
    report.check_max("agent.batch_nodes", host.batch_nodes.get() as u64, MAX_BATCH_NODES);
    report.check_max("agent.batch_bytes", host.batch_bytes.get() as u64, MAX_BATCH_BYTES);
    report.check_max("agent.batch_delay_ms", host.batch_delay_ms.into(), MAX_BATCH_DELAY_MS);
    report.check_max("agent.stop_timeout_ms", host.stop_timeout_ms, MAX_STOP_TIMEOUT_MS);
}

/// Checks `[serve]`. `offers_nothing` is `true` if the host has neither models nor stamps that peers may query.
fn check_serve(report: &mut Report, serve: &ServeConfig, offers_nothing: bool) {
    if offers_nothing && !serve.calibration {
        let text = "this host has nothing to serve; add a [[model]], a folder with models to [bank] or a pipeline that observes, \
                    set calibration = true, or remove [serve]";
        report.add("serve", text);
    }
    report.check_session_settings("serve.session", &serve.session);
    for address in serve.listen.as_slice() {
        report.check_result("serve.network", address.check_network(serve.network));
        report.check_result("serve.listen", address.check_usable_on_this_host());
        check_listen(report, address);
    }
}

/// Checks that this host can listen at an address.
fn check_listen(report: &mut Report, address: &Address) {
    // A port in use is not a problem, because the agent with this configuration may be running. The start of an agent
    // reports a port that another program uses.
    if let Err(error) = address.network().try_bind(address)
        && error.kind() != io::ErrorKind::AddrInUse
    {
        let all_interfaces =
            format!("use {}://0.0.0.0:… for all addresses of this machine", address.scheme());
        let advice = match error.kind() {
            io::ErrorKind::AddrNotAvailable => all_interfaces.as_str(),
            io::ErrorKind::PermissionDenied => "ports below 1024 need a privilege; choose a higher port",
            _ => "check the address",
        };
        report.add("serve.listen", format!("cannot listen on {address}: {error}; {advice}"));
    }
}

/// Checks a pipeline; `prefix` is its key, such as `pipeline[0]`.
fn check_pipeline(
    report: &mut Report,
    prefix: &str,
    pipeline: &PipelineConfig,
    (models, model_folders): (&[Slug], &[PathBuf]),
    clock: &SharedClock,
) {
    match (&pipeline.sensor, &pipeline.placement) {
        (_, PlacementConfig::Observe(observed)) => check_observed(report, prefix, pipeline, observed),
        (Some(sensor), _) => report.check_result(format!("{prefix}.sensor"), sensor.check(clock)),
        (None, _) => report.add(format!("{prefix}.sensor"), "the pipeline has no sensor; add one"),
    }
    for (index, transform) in pipeline.transforms.iter().enumerate() {
        report.check_result(format!("{prefix}.transforms[{index}]"), transform.build());
    }
    report.check_result(format!("{prefix}.actuator"), pipeline.actuator.check(clock));
    let max_in_flight = pipeline.max_in_flight.get() as u64;
    report.check_max(&format!("{prefix}.max_in_flight"), max_in_flight, u64::from(MAX_IN_FLIGHT));
    report.check_max(&format!("{prefix}.timeout_ms"), pipeline.timeout_ms.get(), MAX_TIMEOUT_MS);
    // An iteration that times out misses its deadline in any case, so a deadline after the timeout has no effect.
    if let Some(deadline) = pipeline.deadline_ms.filter(|deadline| *deadline > pipeline.timeout_ms) {
        let text = format!(
            "{deadline} is later than timeout_ms ({}); choose an earlier deadline",
            pipeline.timeout_ms
        );
        report.add(format!("{prefix}.deadline_ms"), text);
    }
    if let PlacementConfig::Remote(remote) = &pipeline.placement {
        report.check_session_settings(&format!("{prefix}.placement.session"), &remote.session);
        report.check_result(format!("{prefix}.placement.network"), remote.peer.check_network(remote.network));
        report.check_result(format!("{prefix}.placement.peer"), remote.peer.check_usable_on_this_host());
    }
    if let PlacementConfig::Local { model } = &pipeline.placement
        && !models.contains(model)
    {
        let available = match models {
            [] => "this host has no models; add a [[model]]".to_owned(),
            models => {
                let names: Vec<&str> = models.iter().map(Slug::as_str).collect();
                format!("this host has {}", names.join(", "))
            }
        };
        let searched_folders = match model_folders {
            [] => String::new(),
            folders => {
                let folders: Vec<String> =
                    folders.iter().map(|folder| folder.display().to_string()).collect();
                format!("; looked in the tables [[model]] and in the folders {}", folders.join(", "))
            }
        };
        report.add(
            format!("{prefix}.placement.model"),
            format!("no model is named {model}; {available}{searched_folders}"),
        );
    }
    if let Some(hz) = pipeline.load.hz()
        && !(hz * MAX_RUN_S >= 1.0 && hz <= 100_000.0)
    {
        // The debug format shows 1e-300 as such; the normal format would print 300 zeros.
        report.add(
            format!("{prefix}.load.hz"),
            format!("{hz:?} is not a rate of at least one start a year and at most 100000 per second"),
        );
    }
    if let Some(seconds) = pipeline.limit.duration_s
        && !(seconds > 0.0 && seconds <= MAX_RUN_S)
    {
        report.add(
            format!("{prefix}.limit.duration_s"),
            format!("{seconds:?} is not a number of seconds above 0 and at most {MAX_RUN_S}"),
        );
    }
    if pipeline.placement == (PlacementConfig::None {}) && pipeline.actuator.acts() {
        report.add(
            format!("{prefix}.actuator"),
            "a pipeline that only senses has no answers to act on; remove the actuator",
        );
    }
    if pipeline.episode_steps.is_none() && pipeline.limit.episodes.is_some() {
        let text = "episodes needs episode_steps, the maximum number of iterations of an episode; otherwise the run might never end";
        report.add(format!("{prefix}.limit.episodes"), text);
    }
    let warm_up = &pipeline.warm_up;
    if pipeline.episode_steps.is_none() && (warm_up.episodes > 0 || warm_up.steps > 0) {
        let text = "episodes and steps need episode_steps; set episode_steps, or use iterations instead";
        report.add(format!("{prefix}.warm_up"), text);
    }
}

/// Checks a pipeline that observes a ROS system.
fn check_observed(report: &mut Report, prefix: &str, pipeline: &PipelineConfig, observed: &ObserveConfig) {
    // These keys are reported rather than ignored, because a user who sets them expects an effect.
    let unused_keys = [
        ("sensor", pipeline.sensor.is_some()),
        ("transforms", !pipeline.transforms.is_empty()),
        ("load", pipeline.load != LoadConfig::default()),
        ("actuator", pipeline.actuator.acts()),
    ];
    for (key, _) in unused_keys.into_iter().filter(|(_, is_set)| *is_set) {
        report.add(
            format!("{prefix}.{key}"),
            format!("a pipeline that observes does not use {key}; remove it"),
        );
    }
    if observed.input == observed.output {
        let text = "output is the same topic as input; name the topic that the observed nodes publish";
        report.add(format!("{prefix}.placement.output"), text);
    }
    if let Err(error) = observed.check_peer() {
        report.add(format!("{prefix}.placement.{}", error.key()), error);
    }
    if let Some(peer) = &observed.peer {
        report.check_result(format!("{prefix}.placement.peer"), peer.check_usable_on_this_host());
    }
    match observed.resolve_version(|name| std::env::var(name).ok()) {
        Ok(version) => {
            for (key, topic) in [("input", &observed.input), ("output", &observed.output)] {
                report.check_result(format!("{prefix}.placement.{key}"), check_name(version, topic));
            }
        }
        Err(error) => report.add(format!("{prefix}.placement.{}", error.key()), error),
    }
}

/// Reason why a configured folder cannot be used.
#[derive(Debug, thiserror::Error)]
enum FolderError {
    #[error("{} is not a folder; choose another {key}", .path.display())]
    NotAFolder { path: PathBuf, key: &'static str },
    #[error("cannot write to {}: {source}; change its permissions or choose another {key}", .path.display())]
    NotWritable { path: PathBuf, key: &'static str, source: io::Error },
}

/// Checks that files can be created in a folder, or that the folder can be created if it does not exist.
fn check_writable(folder: &Path, key: &'static str) -> Result<(), FolderError> {
    // A missing folder is created at the start, so its nearest existing parent must be writable.
    let existing = folder.ancestors().find(|folder| folder.exists() || folder.as_os_str().is_empty());
    let existing = existing.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or_else(|| Path::new("."));
    if !existing.is_dir() {
        return Err(FolderError::NotAFolder { path: existing.to_owned(), key });
    }
    // Creating a file in a folder needs permission both to write to the folder and to enter it.
    access(existing, Access::WRITE_OK | Access::EXEC_OK).map_err(|error| FolderError::NotWritable {
        path: existing.to_owned(),
        key,
        source: error.into(),
    })
}
