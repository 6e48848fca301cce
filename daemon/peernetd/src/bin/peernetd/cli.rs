//! The command line of `peernetd`.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use peernetd::VERSION;

/// PEERNet's daemon: profiles edge-cloud loops live, stage by stage.
///
/// One binary, two roles that the configuration switches on, together or apart: the agent runs sensing,
/// transport and inference workers and streams what it measures; the aggregator stores the measurements of
/// all agents and serves the dashboard and the REST API.
#[derive(Debug, Parser)]
#[command(name = "peernetd", version = VERSION, max_term_width = 100)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the roles that a configuration file switches on, until SIGTERM or Ctrl-C.
    Run {
        /// The configuration file (TOML); see configs/ for one per way of use.
        #[arg(value_name = "CONFIG")]
        config: PathBuf,
    },
    /// Check a configuration file and everything it names: files, folders, models, libraries, addresses.
    ///
    /// Prints each problem with file, line and key, and exits with 78 when there is one.
    Check {
        /// The configuration files to check.
        #[arg(value_name = "CONFIG", required = true)]
        configs: Vec<PathBuf>,
    },
}
