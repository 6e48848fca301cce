//! Files in which the roles of a configuration store data.

use std::path::{Path, PathBuf};

use super::load::{Problem, read_unchecked};

/// Data files of the enabled roles.
#[derive(Debug)]
pub(crate) struct DataFiles {
    /// Database of the aggregator.
    pub(crate) database: Option<PathBuf>,
    /// Spool of the agent, if the agent reports to an aggregator.
    pub(crate) spool: Option<PathBuf>,
}

/// Returns the data files that a configuration names.
// The rest of the configuration is not checked, because a missing model must not prevent a backup.
///
/// # Errors
/// If the configuration cannot be read or parsed.
pub(crate) fn data_files(file: &Path) -> Result<DataFiles, Vec<Problem>> {
    let configuration = read_unchecked(file)?;
    let database = configuration.aggregator.map(|aggregator| aggregator.database);
    let spool = configuration
        .agent
        .filter(|config| config.agent.aggregator.is_some())
        .map(|config| config.spool.path(&config.agent.state_dir));
    Ok(DataFiles { database, spool })
}
