//! The command `peernet`, and the parts that it shares with `peernetd`: clocks, exit codes, texts of errors about
//! invalid values, output to the terminal, shortening of long texts, the form of log lines, reading of small files,
//! renamed tables, requests to end, and the version.

mod address;
mod api;
mod calibrate;
pub mod clock;
mod compare;
mod completions;
pub mod exit;
mod experiment;
mod foreground;
pub mod log;
mod measure;
mod models;
mod network;
pub mod output;
mod paper_commands;
mod plot;
mod recompute;
#[cfg(test)]
mod reference;
pub mod renamed_tables;
mod run;
mod seconds;
pub mod short;
pub mod shutdown_request;
pub mod shutdown_signals;
pub mod small_file;
mod status;
pub mod toml_errors;

use std::process::ExitCode;

use crate::exit::Failure;
use clap::error::{ContextKind, ContextValue};
use clap::{Parser, Subcommand};

/// Version of the program with the commit that it was built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("PEERNET_COMMIT"), ")");

/// Names under which the program acts as the command line: `peernet` and those of the paper's program.
pub const NAMES: [&str; 3] = ["peernet", "PEERNet", "peernet_cli"];

/// Run the experiments of the paper, measure links, compare results, and query a running aggregator.
#[derive(Debug, Parser)]
#[command(
    name = "peernet",
    version = VERSION,
    max_term_width = 100,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    arg_required_else_help = true,
    after_help = "To begin: `peernetd run configs/cloud.toml` in one terminal, `peernet run configs/experiments/demo.toml` in another; the package has the files of configs/ in /usr/share/doc/peernet/examples/. `peernet COMMAND --help` shows the options of one command, docs/cli.md those of all commands."
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Options without a subcommand, as in the commands of the paper: `peernet --server …`, `peernet --client …`.
    #[command(flatten)]
    paper: Option<paper_commands::Arguments>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show the last ten seconds of every pipeline, with quantiles of the total and means of the stages, and the
    /// state of the hosts.
    Status(status::Arguments),
    /// Study a link: one-way delay against payload size, in both directions, and whether the clocks can be trusted.
    Calibrate(calibrate::Arguments),
    /// Run an experiment: a matrix of runs from one file, with tables and figures at the end.
    Run(run::Arguments),
    /// Compare runs: the paper's table, and differences between runs with their uncertainty.
    Compare(compare::Arguments),
    /// Draw figures of results, as PNG, SVG and PDF.
    Plot(plot::Arguments),
    /// Compute the one-way delays of a stored run again, with all clock exchanges during and after the run.
    Recompute(recompute::Arguments),
    /// List, show, check and measure the models on this machine.
    Models(models::Arguments),
    /// Print a script that completes commands and options in a shell.
    Completions(completions::Arguments),
    /// Execute one run in this process, as `peernet run` does for each of its runs.
    #[command(hide = true)]
    Measure(measure::Arguments),
}

impl Command {
    fn run(&self) -> Result<(), Failure> {
        match self {
            Self::Status(arguments) => status::run(arguments),
            Self::Calibrate(arguments) => calibrate::run(arguments),
            Self::Run(arguments) => run::run(arguments),
            Self::Compare(arguments) => compare::run(arguments),
            Self::Plot(arguments) => plot::run(arguments),
            Self::Recompute(arguments) => recompute::run(arguments),
            Self::Models(arguments) => models::run(arguments),
            Self::Completions(arguments) => completions::run(arguments),
            Self::Measure(arguments) => measure::run(arguments),
        }
    }
}

/// Subcommands that only `peernetd` has.
const DAEMON_COMMANDS: [&str; 5] = ["check", "backup", "doctor", "rebuild-rollups", "clear-host-secret"];

/// Adds a tip to an error about a subcommand that `peernet` does not have, if `peernetd` has it.
fn with_daemon_tip(mut error: clap::Error) -> clap::Error {
    let Some(ContextValue::String(unknown_command)) = error.get(ContextKind::InvalidSubcommand) else {
        return error;
    };
    if DAEMON_COMMANDS.contains(&unknown_command.as_str()) {
        let tip = format!("the daemon has this command: peernetd {unknown_command}");
        let _previous = error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// Runs the program `peernet`: parses the command line and executes the command.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return output::report_parser_message(with_daemon_tip(error)).into_exit_code(),
    };
    let result = match cli {
        Cli { command: Some(command), .. } => command.run(),
        Cli { paper: Some(arguments), .. } => paper_commands::run(&arguments),
        // The parser requires a subcommand or the options of the paper, so this does not happen.
        Cli { .. } => Ok(()),
    };
    output::report_result(result).into_exit_code()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_command_of_daemon_gets_tip_with_peernetd() {
        let error_text = |command: &str| {
            let error = Cli::try_parse_from(["peernet", command]).expect_err("peernet has no such command");
            with_daemon_tip(error).to_string()
        };
        assert!(
            error_text("doctor").contains("tip: the daemon has this command: peernetd doctor"),
            "{}",
            error_text("doctor")
        );
        assert!(!error_text("dostor").contains("peernetd"), "{}", error_text("dostor"));
    }
}
