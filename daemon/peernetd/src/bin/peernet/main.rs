//! `peernet`: PEERNet's command line.

mod api;
mod calibrate;
mod recompute;
mod status;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use peernetd::VERSION;
use peernetd::exit::Exit;
use peernetd::output::complain;

/// PEERNet's command line: asks a running aggregator, measures links.
#[derive(Debug, Parser)]
#[command(name = "peernet", version = VERSION, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show what runs where and how it fares: the last ten seconds of every pipeline, and the hosts.
    Status(status::Arguments),
    /// Study a link: one-way delay against payload size, both ways, and whether the clocks can be trusted.
    Calibrate(calibrate::Arguments),
    /// Compute the one-way delays of a stored run again, with what was learnt of the clocks after it.
    Recompute(recompute::Arguments),
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
            // Printing fails when nobody listens any more; the exit code still tells.
            let _ = error.print();
            return if asked { Exit::Ok } else { Exit::Usage }.into();
        }
    };
    let done = match arguments.command {
        Command::Status(arguments) => status::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Recompute(arguments) => recompute::run(&arguments),
    };
    match done {
        Ok(()) => Exit::Ok,
        Err(failure) => {
            complain(&failure);
            failure.exit
        }
    }
    .into()
}
