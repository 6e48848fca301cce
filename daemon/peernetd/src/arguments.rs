//! The command line of `peernetd`.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use peernet_cli::VERSION;

use crate::commands::{Database, DoctorArguments};

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
    /// Copy an aggregator's database to a file, as it is at this moment; the aggregator may go on storing.
    ///
    /// The copy is complete and on the disk when this ends with 0, and is a database like the first: stop the
    /// aggregator, put the copy in the place of its database, start it again. A file that exists is not written over.
    /// Exits with 65 when the file is no aggregator's database, 69 when there is no copy for another reason (no room, no
    /// such database), 130 when interrupted; nothing is left then.
    Backup {
        #[command(flatten)]
        database: Database,
        /// The copy.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Examine an aggregator's database or an agent's spool: damage, gaps, streams, sizes. Changes nothing.
    ///
    /// Reads the whole file once; the aggregator or agent may go on. Exits with 0 when nothing is wrong, 65 when
    /// something is (it says what, and what to do), 69 when a file cannot be opened. With --repair it exits with 0 when
    /// the database is whole afterwards, 65 when nothing of it can be read, 69 when the aggregator runs or the new file
    /// cannot be written.
    Doctor(DoctorArguments),
    /// Compute an aggregator's roll-ups again from the nodes that are stored, while the aggregator is stopped.
    ///
    /// Roll-ups grow with the nodes and need no rebuilding; this is for a doubt, or a repaired file. Each run is
    /// replaced at once; of times whose nodes were deleted the roll-ups stay as they are. Exits with 65 when the file is
    /// no aggregator's database, 69 when the aggregator runs or the database cannot be written; interrupted, the runs
    /// that were done are done.
    RebuildRollups {
        #[command(flatten)]
        database: Database,
        /// Only this run, by its number.
        #[arg(long, value_name = "NUMBER")]
        run: Option<i64>,
    },
    /// Forget the secret with which a host proves its id, so that the next agent with this host id is let in.
    ///
    /// For a robot that lost the file host-secret in its state directory. Until it has come, any agent that claims the
    /// host id is enrolled in its place. The aggregator may go on; stored data stays. Exits with 64 when there is no such
    /// host, 65 when the file is no aggregator's database, 69 when it cannot be written.
    ClearHostSecret {
        #[command(flatten)]
        database: Database,
        /// Name or id of the host.
        #[arg(value_name = "HOST")]
        host: String,
    },
}
