//! Locks of the folders with the identities of the runs' agents. An experiment holds them from its beginning to its
//! end.
//!
//! Two agents cannot be the same host to an aggregator. If two experiments have hosts with the same names, the second
//! could not measure a single run, so the locks refuse it at its start.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};

use super::plan::{Plan, Run};
use crate::measure::{AGENT_LOCK, AgentStateDir, UndeliveredEvents, undelivered, undelivered_in_spool};

/// File that an experiment locks.
const LOCK: &str = "experiment.lock";

/// Locks of folders that no other experiment uses; dropping it releases them.
#[derive(Debug)]
pub(super) struct AgentStateDirs {
    _locks: Vec<File>,
}

/// Reason why a folder cannot be locked.
#[derive(Debug, thiserror::Error)]
pub(super) enum LockError {
    /// Another experiment or agent uses the folder.
    #[error("another peernet process runs as the host whose id is in {}, which this experiment needs; wait for it, stop it, or give this experiment its own [agent] name", .0.display())]
    InUse(PathBuf),
    /// The folder or a file in it cannot be created, opened or locked.
    #[error("cannot {action} {}: {source}", .path.display())]
    Unusable { action: &'static str, path: PathBuf, source: io::Error },
}

impl LockError {
    /// Returns a function that adds the action and the path to an error.
    fn cannot(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Unusable { action, path, source }
    }
}

impl From<LockError> for Failure {
    fn from(error: LockError) -> Self {
        Self::new(Exit::Unavailable, error)
    }
}

impl AgentStateDirs {
    /// Locks the folders of the agents of these runs. Without an aggregator each agent has a temporary folder, which
    /// needs no lock.
    ///
    /// # Errors
    /// When another experiment or agent uses a folder, or a folder cannot be created (exit code 69).
    pub(super) fn acquire(plan: &Plan, runs: &[Run]) -> Result<Self, Failure> {
        Ok(Self::lock(&folders(plan, runs)?)?)
    }

    /// Creates these folders and locks them.
    ///
    /// # Errors
    /// When another experiment or agent uses a folder, or a folder or a file in it cannot be created
    /// or opened.
    pub(super) fn lock(folders: &BTreeSet<PathBuf>) -> Result<Self, LockError> {
        let locks = folders.iter().map(|folder| {
            fs::create_dir_all(folder).map_err(LockError::cannot("create", folder))?;
            let path = folder.join(LOCK);
            let lock = File::options().create(true).append(true).open(&path);
            let lock = lock.map_err(LockError::cannot("write", &path))?;
            take_lock(&lock, folder, &path)?;
            let path = folder.join(AGENT_LOCK);
            match File::options().append(true).open(&path) {
                // This lock is taken and released at once, because the agents of the runs will hold it.
                Ok(agents) => take_lock(&agents, folder, &path)?,
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(LockError::cannot("write", &path)(error)),
            }
            Ok(lock)
        });
        Ok(Self { _locks: locks.collect::<Result<_, _>>()? })
    }
}

fn folders(plan: &Plan, runs: &[Run]) -> Result<BTreeSet<PathBuf>, Failure> {
    let mut folders = BTreeSet::new();
    for run in runs {
        let configuration = plan.configuration(run);
        if configuration.agent.agent.aggregator.is_none() {
            continue;
        }
        for user in 0..configuration.users {
            let mut agent = configuration.agent.agent.clone();
            agent.name = plan.agent_name(run, user);
            folders.insert(AgentStateDir::for_agent(&agent)?.folder().to_owned());
        }
    }
    Ok(folders)
}

/// Returns events on the hosts of a plan that were not yet delivered to their aggregators. No run may be active.
///
/// # Errors
/// When there is no folder for the state of the hosts (exit code 69).
pub(super) async fn undelivered_events(plan: &Plan) -> Result<Vec<UndeliveredEvents>, Failure> {
    let mut events = Vec::new();
    for folder in folders(plan, &plan.runs)? {
        events.extend(undelivered(&folder).await);
    }
    // A configuration may name a spool file outside the state folders.
    let mut spool_files = BTreeSet::new();
    for agent in plan.configurations.iter().map(|configuration| &configuration.agent) {
        let (Some(file), Some(aggregator)) = (&agent.spool.file, &agent.agent.aggregator) else { continue };
        if spool_files.insert(file) {
            events.extend(undelivered_in_spool(file, aggregator).await);
        }
    }
    Ok(events)
}

/// Locks the open file at `path`. The lock lasts until `lock` is closed.
///
/// # Errors
/// When another process holds the lock, or the file cannot be locked.
fn take_lock(lock: &File, folder: &Path, path: &Path) -> Result<(), LockError> {
    match lock.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(LockError::InUse(folder.to_owned())),
        Err(TryLockError::Error(error)) => Err(LockError::cannot("lock", path)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_belongs_to_one_experiment_at_a_time() {
        let state = tempfile::tempdir().expect("a folder");
        let named =
            |names: &[&str]| names.iter().map(|name| state.path().join(name)).collect::<BTreeSet<_>>();
        let first = AgentStateDirs::lock(&named(&["robot-1", "robot-2"])).expect("they are free");
        let refused = AgentStateDirs::lock(&named(&["robot-2", "robot-3"])).expect_err("one is taken");
        assert!(refused.to_string().contains("robot-2, which this experiment"), "{refused}");
        assert!(refused.to_string().contains("its own [agent] name"), "{refused}");
        assert_eq!(Failure::from(refused).exit, Exit::Unavailable);
        AgentStateDirs::lock(&named(&["robot-3"])).expect("a refused experiment holds no lock");
        drop(first);
        AgentStateDirs::lock(&named(&["robot-1", "robot-2"])).expect("they are free again");
    }

    #[test]
    fn unusable_folder_is_not_reported_as_in_use() {
        let state = tempfile::tempdir().expect("a folder");
        let file = state.path().join("robot-1");
        fs::write(&file, "").expect("writable");
        let error = AgentStateDirs::lock(&BTreeSet::from([file])).expect_err("a file is no folder");
        assert!(matches!(error, LockError::Unusable { action: "create", .. }), "{error}");
        assert!(error.to_string().contains("robot-1"), "{error}");
    }

    #[test]
    fn lock_rejects_foreign_and_admits_own_agents() {
        let state = tempfile::tempdir().expect("a folder");
        let folders = BTreeSet::from([state.path().to_owned()]);
        let agent = File::create(state.path().join(AGENT_LOCK)).expect("writable");
        agent.try_lock().expect("it is free");
        AgentStateDirs::lock(&folders).expect_err("an agent has it");
        agent.unlock().expect("let go");
        let _agent_state_dirs = AgentStateDirs::lock(&folders).expect("it is free");
        agent.try_lock().expect("the experiment's own agent takes it");
    }
}
