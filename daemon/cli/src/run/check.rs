//! Check of configurations before anything is tried.

use std::path::Path;

use crate::exit::{Exit, Failure};
use crate::short::shorten_label;
use anyhow::anyhow;
use peernet_agent::{Agent, AgentConfig};
use peernet_clock::SharedClock;

use super::file::Configuration;
use super::plan::describe_labels;

/// Keys that concern this machine and not the file: pictures, models, programs.
const MACHINE_KEYS: [&str; 4] =
    ["pipeline[0].sensor", "pipeline[0].placement", "pipeline[0].actuator", "bank"];

/// Replaces the key of an agent's only pipeline in an error by the key in an experiment's file.
pub(super) fn with_experiment_keys(problem: &str) -> String {
    problem.replacen("pipeline[0]", "pipeline", 1)
}

/// Checks every configuration of a file as an agent would. Returns the problems of this machine only, each once.
///
/// # Errors
/// When something is wrong on any machine (78).
pub(super) fn configurations(
    file: &Path,
    configurations: &[Configuration],
    clock: &SharedClock,
) -> Result<Vec<String>, Failure> {
    let (mut file_problems, mut machine_problems): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    let folder = std::env::temp_dir();
    for configuration in configurations {
        let mut agent: AgentConfig = configuration.agent.clone();
        agent.agent.state_dir.clone_from(&folder);
        for problem in Agent::check(&agent, clock) {
            let is_machine_key = MACHINE_KEYS.contains(&problem.key.as_str())
                || problem.key.starts_with("model[") && problem.key.ends_with(']')
                || MACHINE_KEYS.iter().any(|key| problem.key.starts_with(&format!("{key}.")));
            let labels = shorten_label(&describe_labels(&configuration.labels));
            let label_note = if labels.is_empty() { String::new() } else { format!(" (with {labels})") };
            let text = with_experiment_keys(&problem.to_string());
            let list = if is_machine_key { &mut machine_problems } else { &mut file_problems };
            if !list.iter().any(|other| other.starts_with(&text)) {
                list.push(format!("{text}{label_note}"));
            }
        }
    }
    if file_problems.is_empty() {
        return Ok(machine_problems);
    }
    let file_problems: Vec<String> =
        file_problems.iter().map(|text| format!("{}: {text}", file.display())).collect();
    Err(Failure::new(Exit::Configuration, anyhow!("{}", file_problems.join("\n"))))
}
