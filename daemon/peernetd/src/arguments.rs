//! The command line of `peernetd`.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use peernet_cli::VERSION;

use crate::commands::{DatabaseArgument, DoctorArguments};

/// PEERNet's daemon: profiles edge-cloud loops live, stage by stage.
///
/// The configuration enables one or both of two roles. The agent runs sensing, transport and inference workers and
/// sends its measurements to an aggregator. The aggregator stores the measurements of all agents and serves the
/// dashboard and the REST API.
#[derive(Debug, Parser)]
#[command(name = "peernetd", version = VERSION, max_term_width = 100)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the roles that a configuration file enables, until SIGTERM or Ctrl-C.
    Run {
        /// The configuration file (TOML); configs/ has examples for each kind of use.
        #[arg(value_name = "CONFIG")]
        config: PathBuf,
    },
    /// Check configuration files and everything they name: files, folders, models, libraries, addresses.
    ///
    /// Prints each problem with file, line and key, and exits with 78 if there is one.
    Check {
        /// The configuration files to check.
        #[arg(value_name = "CONFIG", required = true)]
        configs: Vec<PathBuf>,
    },
    /// Copy the current state of an aggregator's database to a file; the aggregator may continue to store.
    ///
    /// The copy is complete and on the disk when the command exits with 0. To restore it, stop the aggregator, replace
    /// its database with the copy, and start the aggregator again. An existing file is not overwritten. Exits with 65
    /// if the file is not an aggregator's database, 69 if the copy failed for another reason (no space left, no such
    /// database), 130 if it was interrupted; a partial copy is removed.
    Backup {
        #[command(flatten)]
        database: DatabaseArgument,
        /// The file to write the copy to.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Examine an aggregator's database or an agent's spool: damage, gaps, streams, sizes. Changes nothing.
    ///
    /// Reads the whole file; the aggregator or agent may continue. Exits with 0 if there is no problem, 65 if
    /// there is one (each is printed with advice), 69 if a file cannot be opened. With --repair it exits with 0 if the
    /// database is intact afterwards, 65 if nothing of the database can be read, 69 if the aggregator runs or the new
    /// file cannot be written.
    Doctor(DoctorArguments),
    /// Compute an aggregator's roll-ups again from the stored nodes, while the aggregator is stopped.
    ///
    /// The aggregator updates roll-ups when it stores nodes, so this command is needed only after a repair or if
    /// roll-ups may be wrong. The roll-ups of each run are replaced in one transaction. Roll-ups of intervals whose
    /// nodes were deleted do not change. Exits with 65 if the file is not an aggregator's database, 69 if the
    /// aggregator runs or the database cannot be written. If the command is interrupted, the runs completed so far keep
    /// their new roll-ups.
    RebuildRollups {
        #[command(flatten)]
        database: DatabaseArgument,
        /// Number of the only run to compute; default: all runs.
        #[arg(long, value_name = "NUMBER")]
        run: Option<i64>,
    },
    /// Delete the secret with which a host proves its id, so that the next agent with this host id is accepted.
    ///
    /// Use it for a robot that lost the file host-secret in its state directory. Until the robot connects, any agent
    /// with this host id is accepted in its place. The aggregator may continue; stored data does not change. Exits with
    /// 64 if there is no such host, 65 if the file is not an aggregator's database, 69 if the file cannot be written.
    ClearHostSecret {
        #[command(flatten)]
        database: DatabaseArgument,
        /// Name or id of the host.
        #[arg(value_name = "HOST")]
        host: String,
    },
}
