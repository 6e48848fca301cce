//! `peernet completions`

use crate::exit::{Exit, Failure};
use crate::output::print_to_stdout;
use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;

use crate::Cli;

/// Arguments of `peernet completions`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Shell that will run the script.
    shell: Shell,
}

/// Prints the script.
///
/// # Errors
/// When the script is not UTF-8 (exit code 70), which does not happen.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Cli::command(), "peernet", &mut script);
    let script = String::from_utf8(script).context("the script is not text");
    print_to_stdout(script.map_err(|error| Failure::new(Exit::Software, error))?.trim_end());
    Ok(())
}
