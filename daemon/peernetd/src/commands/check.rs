//! The command `peernetd check`.

use std::fmt::Display;
use std::path::PathBuf;

use peernet_agent::Agent;

use crate::configuration::load;
use peernet_cli::exit::Exit;
use peernet_cli::output::{print_to_stderr, print_to_stdout};

/// Checks each file and reports every problem.
pub(crate) fn check(files: &[PathBuf]) -> Exit {
    let mut exit = Exit::Ok;
    for file in files {
        match load(file) {
            Ok(configuration) => {
                print_to_stdout(format_args!("{}: ok", file.display()));
                for line in &configuration.deprecation_lines {
                    print_to_stdout(format_args!("deprecated: {line}"));
                }
                let note = |text: &dyn Display| {
                    print_to_stdout(format_args!("{}: note: {text}", file.display()));
                };
                // Only an agent has remarks.
                let Some(agent) = &configuration.agent else { continue };
                match configuration.clock() {
                    Ok(clock) => Agent::remarks(agent, &clock).into_iter().for_each(|remark| note(&remark)),
                    Err(error) => note(&format_args!(
                        "the agent's settings were not examined for remarks, because the clock cannot be read: {error}"
                    )),
                }
            }
            Err(problems) => {
                for problem in problems {
                    print_to_stderr(problem);
                }
                exit = Exit::Configuration;
            }
        }
    }
    exit
}
