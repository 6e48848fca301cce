//! The commands of the paper: `peernet --server …` on the device that serves, `peernet --client …` on the device that
//! senses.
//!
//! They run the daemon's pipeline code in the foreground, configured by the options of the paper's program.

mod arguments;
mod client;
mod client_progress;
mod devices;
mod encoding;
mod model;
mod sensor;
mod serve_observer;
mod server;

pub(crate) use arguments::Arguments;
pub(crate) use devices::{DeviceAddresses, addresses};

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use anyhow::anyhow;

use devices::Devices;

use crate::foreground::{LogDestination, start_log};

/// Serves or measures, depending on the options.
///
/// # Errors
/// Each kind of error has its exit code: `docs/cli.md`.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let devices = Devices::read(&arguments.network_config, arguments.network)?;
    let serves = !arguments.client;
    devices.check(&arguments.name, serves)?;
    print_to_stderr("plain mode: no encryption and no authentication; use it only in trusted networks");
    start_log(LogDestination::StandardError)?;
    if serves { server::run(arguments, &devices) } else { client::run(arguments, &devices) }
}

/// Returns the command of `exec:COMMAND`, or `None` for another form.
fn exec_command(text: &str) -> Result<Option<&str>, Failure> {
    match text.strip_prefix("exec:") {
        Some(command) if command.trim().is_empty() => {
            Err(Failure::new(Exit::Usage, anyhow!("{text:?} names no program: write exec:COMMAND")))
        }
        command => Ok(command),
    }
}
