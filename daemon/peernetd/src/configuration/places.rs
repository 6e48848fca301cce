//! Where a configuration keeps what it stores.

use std::path::{Path, PathBuf};

use super::load::{Problem, read_unchecked};

/// The files of the roles that are on.
#[derive(Debug)]
pub(crate) struct Places {
    /// The aggregator's database.
    pub(crate) database: Option<PathBuf>,
    /// The agent's spool; only where it reports to an aggregator.
    pub(crate) spool: Option<PathBuf>,
}

/// Looks up the files without checking anything else: a model that is missing does not keep a backup from being made.
///
/// # Errors
/// When the configuration cannot be read or understood.
pub(crate) fn places(file: &Path) -> Result<Places, Vec<Problem>> {
    let configuration = read_unchecked(file)?;
    let database = configuration.aggregator.map(|aggregator| aggregator.database);
    let spool = configuration
        .agent
        .filter(|config| config.agent.aggregator.is_some())
        .map(|config| config.spool.path(&config.agent.state_dir));
    Ok(Places { database, spool })
}
