//! `peernetd`: the daemon. Composes the roles that a configuration file switches on.

mod cli;
mod commands;
mod configuration;

mod lifecycle;
mod log;

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use cli::{Arguments, Command};
use peernetd::exit::Exit;

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
    match arguments.command {
        Command::Run { config } => commands::run(&config),
        Command::Check { configs } => commands::check(&configs),
        Command::Backup { database, file } => commands::backup(database, &file),
        Command::RebuildRollups { database, run } => commands::rebuild(database, run),
        Command::Doctor(arguments) => commands::doctor(arguments),
    }
    .into()
}
