//! `peernetd check`

use std::path::PathBuf;

use crate::configuration::load;
use peernetd::exit::Exit;
use peernetd::output::{complain, say};

/// Checks each file and reports every problem.
pub(crate) fn check(files: &[PathBuf]) -> Exit {
    let mut exit = Exit::Ok;
    for file in files {
        match load(file) {
            Ok(_) => say(format_args!("{}: ok", file.display())),
            Err(problems) => {
                for problem in problems {
                    complain(problem);
                }
                exit = Exit::Configuration;
            }
        }
    }
    exit
}
