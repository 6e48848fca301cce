//! The daemon `peernetd`: runs the roles that a configuration file enables (agent, aggregator), and maintains the
//! databases of these roles.

mod arguments;
mod commands;
mod configuration;
mod library_telemetry;
mod lifecycle;
mod log;

use std::process::ExitCode;

use clap::Parser;

pub use self::library_telemetry::disable_library_telemetry;

use self::arguments::{Arguments, Command};
use peernet_cli::output;

/// Main function of `peernetd`: executes the command line.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return output::report_parser_message(error).into_exit_code(),
    };
    // The umask must be set before threads start. Databases, spools and backups must not be readable by other users.
    peernet_permissions::restrict_new_files();
    let exit = match arguments.command {
        Command::Run { config } => commands::run(&config),
        Command::Check { configs } => commands::check(&configs),
        Command::Backup { database, file } => commands::backup(database, &file),
        Command::RebuildRollups { database, run } => commands::rebuild(database, run),
        Command::ClearHostSecret { database, host } => commands::clear_secret(database, &host),
        Command::Doctor(arguments) => commands::doctor(arguments),
    };
    output::with_output_errors(exit).into_exit_code()
}
