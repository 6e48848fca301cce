//! Arguments that select the database of a command.

use std::path::PathBuf;

use anyhow::anyhow;
use peernet_cli::exit::{Exit, Failure};

use crate::configuration::{Problem, data_files};

/// The aggregator's database: its path, or a configuration that names it.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(crate) struct DatabaseArgument {
    /// The configuration file whose [aggregator] names the database.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The database file.
    #[arg(long, value_name = "FILE")]
    database: Option<PathBuf>,
}

impl DatabaseArgument {
    /// Returns the path of the database.
    ///
    /// # Errors
    /// If the configuration cannot be read or has no aggregator.
    pub(crate) fn path(self) -> Result<PathBuf, Failure> {
        match (self.database, self.config) {
            (Some(path), _) => Ok(path),
            (None, Some(config)) => data_files(&config)
                .map_err(|problems| configuration_failure(&problems))?
                .database
                .ok_or_else(|| {
                    let error =
                        anyhow!("{} names no database: it has no table [aggregator]", config.display());
                    Failure::new(Exit::Configuration, error)
                }),
            (None, None) => Err(Failure::new(Exit::Usage, anyhow!("give --config or --database"))),
        }
    }
}

/// Returns the failure of a command whose configuration has these problems. The text has a line for each problem.
pub(super) fn configuration_failure(problems: &[Problem]) -> Failure {
    let lines: Vec<String> = problems.iter().map(ToString::to_string).collect();
    Failure::new(Exit::Configuration, anyhow!(lines.join("\n")))
}
