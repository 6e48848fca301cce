//! Trial of each configuration with a few iterations before the first run: an error now is better than one after an
//! hour.

use std::collections::BTreeSet;
use std::num::NonZeroU64;

use crate::exit::{Exit, Failure};
use anyhow::{Context, anyhow};
use peernet_actuators::ActuatorKind;
use peernet_agent::config::{Limit, LoadConfig, PlacementConfig, WarmUp};
use peernet_analysis::compare::describe_labels;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::pace::Pace;
use peernet_analysis::record::RunRecord;
use peernet_clock::SharedClock;
use peernet_inference::LockedTempDir;
use peernet_networks::Address;
use peernet_results::{Overwrite, ResultFolder};
use peernet_stream::{Condition, Grade};

use super::children::{self, ChildEvent, ProcessResult};
use super::file::Configuration;
use super::plan::Plan;
use crate::foreground::{PeerWait, Progress, Signals, long_duration};
use crate::measure::RunRequest;
use crate::short::shorten_label;

/// Number of iterations of a trial: the first may be slow, the others give the pace.
const ITERATIONS: u64 = 3;
/// Words in the reason of every iteration for which the sensor gave no sample.
const SENSOR: &str = "the sensor";
/// Timeout for an unreachable peer unless the file sets another; seconds. The peer may have to load its model.
const PEER_TIMEOUT_S: f64 = 30.0;

/// Results of the trials.
pub(super) struct TrialResults {
    /// Pace of each configuration; `None` if it was not tried or failed.
    pub(super) paces: Vec<Option<Pace>>,
    /// Number of configurations that were to be tried.
    pub(super) configuration_count: usize,
    /// Descriptions of the configurations that cannot be measured, with the failure of their process.
    pub(super) unavailable: Vec<(String, ProcessResult)>,
    /// Conditions that impair measurements on a host, each once.
    pub(super) conditions: Vec<Condition>,
}

/// A trial, and the indexes of the configurations that share it.
struct Trial {
    request: RunRequest,
    configurations: Vec<usize>,
}

/// Tries the configurations at these indexes. Configurations with equal trials are tried once.
///
/// # Errors
/// When no temporary folder can be created (exit code 69) or the user ended the trial (exit code 130).
pub(super) async fn try_configurations(
    plan: &Plan,
    indexes: &BTreeSet<usize>,
    clock: &SharedClock,
    signals: &mut Signals,
    quiet: bool,
) -> Result<TrialResults, Failure> {
    let folder = LockedTempDir::new("trial")
        .context("cannot create a temporary folder; set TMPDIR to another folder")
        .map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let mut results = TrialResults {
        paces: vec![None; plan.configurations.len()],
        configuration_count: indexes.len(),
        unavailable: Vec::new(),
        conditions: Vec::new(),
    };
    // Peers for which a trial has waited without success. Later trials do not wait for them again.
    let mut unreachable: Vec<(Address, ProcessResult)> = Vec::new();
    let trials = trials(plan, indexes);
    let mut progress = Progress::new(quiet, clock.mono());
    for (done, Trial { request, configurations }) in trials.iter().enumerate() {
        let descriptions = || configurations.iter().map(|index| describe_configuration(plan, *index));
        let state = format!("trying {} of {}: {}", done + 1, trials.len(), describe_group(descriptions()));
        let peer = peer_address(request);
        if let Some((address, result)) = unreachable.iter().find(|(other, _)| Some(other) == peer.as_ref()) {
            if !quiet {
                progress.print_line(format_args!("{state}: skipped, {address} is unreachable"));
            }
            results.unavailable.extend(descriptions().map(|description| (description, result.clone())));
            continue;
        }
        if !quiet {
            progress.print_line(&state);
        }
        let results_dir = folder.path().join(done.to_string());
        let began = clock.mono();
        let requests = [RunRequest { folder: results_dir.clone(), ..request.clone() }];
        let fraction_done = done as f64 / trials.len() as f64;
        let mut process_results = children::execute(&requests, signals, |event| match event {
            ChildEvent::Line(_, line) | ChildEvent::EndAnnouncement(line) => progress.print_line(line),
            ChildEvent::ProgressReport(reports) => {
                let (now, trouble) =
                    (clock.mono(), reports.iter().flatten().find_map(|report| report.trouble.clone()));
                let elapsed = long_duration((now - began).seconds());
                progress.show(now, trouble, || (format!("{state}, for {elapsed}"), fraction_done));
            }
        })
        .await;
        if process_results.interrupted {
            progress.end();
            return Err(Failure::new(Exit::Interrupted, anyhow!("ended before the first run")));
        }
        let loaded = ResultFolder::open(&results_dir).ok();
        let duration_s = (clock.mono() - began).seconds();
        match process_results.results.pop() {
            Some(result) if result.is_successful() || has_answer(&result, loaded.as_ref()) => {
                if let Some(reason) = result.reason.filter(|_| !quiet) {
                    progress.print_line(format_args!(
                        "{state}: {reason}; a run counts failed iterations and continues"
                    ));
                }
                let pace = loaded.as_ref().and_then(|loaded| Pace::from_trial(&loaded.rows, duration_s));
                configurations.iter().for_each(|index| results.paces[*index] = pace);
            }
            Some(result) => {
                let result = describe_failure(request, result);
                if has_given_up_peer(&result) {
                    unreachable.extend(peer.map(|peer| (peer, result.clone())));
                }
                results.unavailable.extend(descriptions().map(|description| (description, result.clone())));
            }
            // There is always a result, because there is one request.
            None => {}
        }
        // A failed trial may have found conditions of the hosts, too.
        if let Some(loaded) = loaded {
            add_conditions(&loaded.record, &mut results.conditions);
        }
    }
    progress.end();
    Ok(results)
}

/// Returns the different trials, in the order of the configurations.
fn trials(plan: &Plan, indexes: &BTreeSet<usize>) -> Vec<Trial> {
    let mut trials: Vec<Trial> = Vec::new();
    let configurations = indexes.iter().filter_map(|index| Some((*index, plan.configurations.get(*index)?)));
    for (index, configuration) in configurations {
        let request = trial_request(plan, configuration);
        // `trial_request` has removed everything from the agent's configuration that a trial does not test, so that
        // requests with equal agents are the same trial.
        let is_same = |trial: &&mut Trial| {
            trial.request.agent == request.agent && trial.request.tried_actuator == request.tried_actuator
        };
        match trials.iter_mut().find(is_same) {
            Some(trial) => trial.configurations.push(index),
            None => trials.push(Trial { request, configurations: vec![index] }),
        }
    }
    trials
}

/// Describes a configuration by its labels, or without axes by the experiment's name.
fn describe_configuration(plan: &Plan, index: usize) -> String {
    let no_repeat = None;
    let description = plan
        .configurations
        .get(index)
        .map(|configuration| shorten_label(&describe_labels(&configuration.labels, no_repeat)));
    description.filter(|text| !text.is_empty()).unwrap_or_else(|| plan.name.to_string())
}

/// Describes configurations with equal trials: the first one, and the number of the others.
fn describe_group(mut descriptions: impl ExactSizeIterator<Item = String>) -> String {
    let first = descriptions.next().unwrap_or_default();
    match descriptions.len() {
        0 => first,
        1 => format!("{first} (and 1 configuration like it)"),
        more => format!("{first} (and {more} configurations like it)"),
    }
}

/// Returns the address of the peer; `None` if the pipeline has no peer.
fn peer_address(request: &RunRequest) -> Option<Address> {
    match &request.agent.pipelines.first()?.placement {
        PlacementConfig::Remote(remote) => Some(remote.peer.clone()),
        PlacementConfig::Local { .. } | PlacementConfig::None {} | PlacementConfig::Observe(_) => None,
    }
}

/// Adds a note to the failure of a sensor: the sensor may depend on the actuator, which a trial does not have.
fn describe_failure(request: &RunRequest, result: ProcessResult) -> ProcessResult {
    let has_actuator = request.tried_actuator.as_ref().is_some_and(ActuatorKind::acts);
    let explain = |reason: String| match reason.contains(SENSOR) && has_actuator {
        true => format!(
            "{reason}; a trial runs without the actuator, so the sensor must give samples before the first action \
             (docs/actuators.md, \"Trials\")"
        ),
        false => reason,
    };
    ProcessResult { reason: result.reason.map(explain), ..result }
}

/// Makes the request for a trial: the configuration with few iterations, without an actuator and without an aggregator.
fn trial_request(plan: &Plan, configuration: &Configuration) -> RunRequest {
    // Custom code may need the variables of the runs: the trial has those of the first repeat and the first user.
    let (repeat, user) = (0, 0);
    let mut agent = plan.seeded_agent(configuration, repeat, user);
    // Dashboards show no trials.
    agent.agent.aggregator = None;
    let mut tried_actuator = None;
    for pipeline in &mut agent.pipelines {
        pipeline.limit = Limit { total: NonZeroU64::new(ITERATIONS), ..Limit::default() };
        pipeline.warm_up = WarmUp { iterations: 0, episodes: 0, steps: 0 };
        pipeline.episode_steps = None;
        // A slow rate would only prolong the trial.
        pipeline.load = LoadConfig::Closed {};
        // No robot moves before the user has confirmed the runs: the process of the trial creates the actuator, drops
        // it, and measures without an actuator.
        tried_actuator = Some(std::mem::take(&mut pipeline.actuator)).filter(ActuatorKind::acts);
    }
    let no_repeat = None;
    RunRequest {
        agent,
        title: describe_labels(&configuration.labels, no_repeat),
        folder: std::path::PathBuf::new(),
        overwrite: Overwrite::Refuse,
        plots: false,
        command: String::new(),
        network_config: None,
        user: None,
        warm_up: String::new(),
        peer_timeout_s: Some(configuration.patience_s.unwrap_or(PEER_TIMEOUT_S)),
        tried_actuator,
    }
}

/// Returns whether a trial succeeded in part: some of its iterations have an answer and some failed. The configuration
/// can be measured then, because failed iterations are part of a result.
fn has_answer(result: &ProcessResult, loaded: Option<&Loaded>) -> bool {
    let is_incomplete = result.code == Some(i32::from(Exit::Incomplete as u8));
    is_incomplete && loaded.is_some_and(|loaded| loaded.rows.iter().any(|row| row.is_in_statistics()))
}

/// Returns whether a trial waited for its peer in vain. A trial that failed for another reason says nothing about the
/// peer, even if it took longer than the timeout.
fn has_given_up_peer(result: &ProcessResult) -> bool {
    result.reason.as_ref().is_some_and(|reason| reason.contains(PeerWait::GAVE_UP))
}

/// Adds the conditions of a run's hosts that impair measurements, unless they are already in the list.
fn add_conditions(record: &RunRecord, conditions: &mut Vec<Condition>) {
    let hosts = std::iter::once(&record.edge).chain(&record.cloud);
    let impairing =
        hosts.flat_map(|host| &host.conditions).filter(|condition| condition.grade >= Grade::Doubtful);
    for condition in impairing {
        let is_same = |other: &Condition| (&other.host, &other.about) == (&condition.host, &condition.about);
        if !conditions.iter().any(is_same) {
            conditions.push(condition.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{MonoTime, Span};

    use super::*;
    use crate::run::tests::plan;

    const FILE: &str = "\
[experiment]
name = 'e'
iterations = 10
[pipeline]
sensor = { kind = 'text', length = 10 }
placement = { kind = 'none' }
[[axis]]
name = 'Length'
field = 'pipeline.sensor.length'
values = [1, 2]
[[axis]]
name = 'Rate'
[[axis.value]]
label = 'closed'
[[axis.value]]
label = '5'
set = { 'pipeline.load' = { mode = 'rate', hz = 5.0 } }
[[axis.value]]
label = '9'
set = { 'pipeline.load' = { mode = 'rate', hz = 9.0 } }
";

    #[test]
    fn only_vain_wait_shows_that_peer_is_unreachable() {
        let result = |reason: Option<String>| ProcessResult { code: Some(69), reason };
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let timeout = PeerWait::new(at(0)).timeout_reason(Some("refused"), at(9), Span::from_seconds(2));
        assert!(has_given_up_peer(&result(Some(timeout.expect("the timeout has passed")))));
        assert!(!has_given_up_peer(&result(Some("the sensor failed: no picture".to_owned()))));
        assert!(!has_given_up_peer(&result(None)));
    }

    #[test]
    fn configurations_with_equal_trials_share_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let plan_with_axes = plan(folder.path(), FILE);
        let trial_groups = |indexes: &[usize]| -> Vec<Vec<usize>> {
            let trials = trials(&plan_with_axes, &indexes.iter().copied().collect());
            trials.into_iter().map(|trial| trial.configurations).collect()
        };
        // A trial has no rate, so the three values of the axis Rate share a trial.
        assert_eq!(trial_groups(&[0, 1, 2, 3, 4, 5]), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(trial_groups(&[2, 3, 5]), [vec![2], vec![3, 5]]);
        let described = |indexes: &[usize]| {
            describe_group(indexes.iter().map(|index| describe_configuration(&plan_with_axes, *index)))
        };
        assert_eq!(described(&[2]), "Length = 1, Rate = 9");
        assert_eq!(described(&[3, 5]), "Length = 2, Rate = closed (and 1 configuration like it)");
        assert_eq!(described(&[0, 1, 2]), "Length = 1, Rate = closed (and 2 configurations like it)");
        let single = plan(folder.path(), FILE.split("[[axis]]").next().expect("the text before the axes"));
        assert_eq!(describe_configuration(&single, 0), "e");
    }
}
