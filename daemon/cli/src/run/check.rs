//! Check of configurations before anything is tried.

use std::collections::BTreeSet;
use std::path::Path;

use crate::exit::{Exit, Failure};
use crate::short::shorten_label;
use anyhow::anyhow;
use peernet_agent::{Agent, AgentConfig};
use peernet_analysis::compare::describe_labels;
use peernet_clock::SharedClock;

use super::file::Configuration;

/// Keys of pictures, models and programs. Whether their values can be used depends on this machine.
const MACHINE_KEYS: [&str; 4] =
    ["pipeline[0].sensor", "pipeline[0].placement", "pipeline[0].actuator", "bank"];

/// A problem and the configurations that have it.
struct Problem {
    text: String,
    /// `true` if another machine may not have the problem.
    concerns_machine: bool,
    /// Labels of the first configuration with the problem; empty without axes.
    first_labels: String,
    /// Number of configurations with the problem.
    configurations: usize,
}

impl Problem {
    /// Returns the text with the configurations, unless all have the problem.
    fn describe(&self, all: usize) -> String {
        let Self { text, first_labels, configurations, .. } = self;
        match configurations {
            _ if *configurations == all || first_labels.is_empty() => text.clone(),
            1 => format!("{text} (with {first_labels})"),
            2 => format!("{text} (with {first_labels} and 1 other configuration)"),
            count => format!("{text} (with {first_labels} and {} other configurations)", count - 1),
        }
    }
}

/// Replaces, in the text of an error, the key of the agent's only pipeline with the key in the experiment's file.
pub(super) fn with_experiment_keys(problem: &str) -> String {
    problem.replacen("pipeline[0]", "pipeline", 1)
}

/// Checks every configuration of a file as an agent would. Returns the problems that another machine may not have, each
/// once.
///
/// # Errors
/// When the file has problems on every machine (exit code 78).
pub(super) fn configurations(
    file: &Path,
    configurations: &[Configuration],
    clock: &SharedClock,
) -> Result<Vec<String>, Failure> {
    let mut problems: Vec<Problem> = Vec::new();
    // A run does not use the `state_dir` of the file. The check replaces it by a folder that every user can write to.
    let folder = std::env::temp_dir();
    for configuration in configurations {
        let mut agent: AgentConfig = configuration.agent.clone();
        agent.agent.state_dir.clone_from(&folder);
        // A configuration may have the same problem in two places, but counts once.
        let mut seen_texts = BTreeSet::new();
        for problem in Agent::check(&agent, clock) {
            // A problem with the key of a whole model, such as `model[1]`, concerns its files or its
            // program. The problem of a single value has a longer key, such as `model[1].workers`.
            let concerns_machine = MACHINE_KEYS.contains(&problem.key.as_str())
                || problem.key.starts_with("model[") && problem.key.ends_with(']')
                || MACHINE_KEYS.iter().any(|key| problem.key.starts_with(&format!("{key}.")));
            let text = with_experiment_keys(&problem.to_string());
            if !seen_texts.insert(text.clone()) {
                continue;
            }
            let no_repeat = None;
            match problems.iter_mut().find(|other| other.text == text) {
                Some(known) => known.configurations += 1,
                None => problems.push(Problem {
                    text,
                    concerns_machine,
                    first_labels: shorten_label(&describe_labels(&configuration.labels, no_repeat)),
                    configurations: 1,
                }),
            }
        }
    }
    let (on_this_machine, on_every_machine): (Vec<Problem>, Vec<Problem>) =
        problems.into_iter().partition(|problem| problem.concerns_machine);
    let describe = |problem: &Problem| problem.describe(configurations.len());
    let (machine_problems, file_problems): (Vec<String>, Vec<String>) =
        (on_this_machine.iter().map(describe).collect(), on_every_machine.iter().map(describe).collect());
    if file_problems.is_empty() {
        return Ok(machine_problems);
    }
    let file_problems: Vec<String> =
        file_problems.iter().map(|text| format!("{}: {text}", file.display())).collect();
    Err(Failure::new(Exit::Configuration, anyhow!("{}", file_problems.join("\n"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_are_named_unless_all_have_the_problem() {
        let problem = |configurations| Problem {
            text: "model[1]: missing".to_owned(),
            concerns_machine: true,
            first_labels: "GPU = here".to_owned(),
            configurations,
        };
        let described = |configurations| problem(configurations).describe(4);
        assert_eq!(described(1), "model[1]: missing (with GPU = here)");
        assert_eq!(described(2), "model[1]: missing (with GPU = here and 1 other configuration)");
        assert_eq!(described(3), "model[1]: missing (with GPU = here and 2 other configurations)");
        assert_eq!(described(4), "model[1]: missing");
    }
}
