//! `peernet`: PEERNet's command line.

mod api;
mod status;
mod table;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use peernetd::VERSION;
use peernetd::exit::Exit;
use peernetd::output::complain;

/// PEERNet's command line: asks a running aggregator.
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
    let Command::Status(arguments) = arguments.command;
    match status::run(&arguments) {
        Ok(()) => Exit::Ok,
        Err(failure) => {
            complain(&failure);
            failure.exit
        }
    }
    .into()
}
