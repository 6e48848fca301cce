//! The command `peernetd check`.

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
                for line in &configuration.deprecated {
                    print_to_stdout(format_args!("deprecated: {line}"));
                }
                for remark in configuration.agent.iter().flat_map(Agent::remarks) {
                    print_to_stdout(format_args!("{}: note: {remark}", file.display()));
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
