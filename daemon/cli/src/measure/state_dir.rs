//! Folder for the state of an agent in a foreground run.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use anyhow::{Context, anyhow};
use peernet_actuators::ActuatorKind;
use peernet_agent::config::HostConfig;
use peernet_agent::{AgentConfig, share_argument_key};
use peernet_inference::{LockedTempDir, ModelConfig};
use peernet_sensors::SensorKind;

use super::spools;

/// A folder for the agent's state: a permanent one if an aggregator is to recognise the host again, otherwise a
/// temporary one.
pub(crate) enum AgentStateDir {
    Permanent(PathBuf),
    Temporary(LockedTempDir),
}

impl AgentStateDir {
    /// Returns the folder of this agent.
    ///
    /// # Errors
    /// When no folder can be used for the state (exit code 69).
    pub(crate) fn for_agent(agent: &HostConfig) -> Result<Self, Failure> {
        let unavailable = |error: anyhow::Error| Failure::new(Exit::Unavailable, error);
        // Without an aggregator nobody has to recognise the host, so no state has to stay.
        if agent.aggregator.is_none() {
            let folder = LockedTempDir::new("agent");
            let folder = folder.context("cannot create a temporary folder; set TMPDIR to another folder");
            return folder.map(Self::Temporary).map_err(unavailable);
        }
        let name = agent.name.as_ref().map_or("unnamed", |name| name.as_str());
        let state = state_root().ok_or_else(|| {
            unavailable(anyhow!(
                "there is no folder for the host id, by which an aggregator recognises this host; set HOME or XDG_STATE_HOME"
            ))
        })?;
        Ok(Self::Permanent(state.join(name)))
    }

    /// Configures an agent to keep its state here.
    ///
    /// # Errors
    /// When the spool of an earlier version cannot be taken over, or the key for fingerprints of program arguments
    /// cannot be read or created (exit code 69).
    pub(crate) fn configure(&self, config: &mut AgentConfig) -> Result<(), Failure> {
        self.folder().clone_into(&mut config.agent.state_dir);
        // All runs of this user share the key for fingerprints, so that equal programs of different runs get equal
        // fingerprints.
        if let Some(root) = state_root().filter(|_| has_programs(config)) {
            share_argument_key(&root, self.folder())
                .map_err(|error| Failure::new(Exit::Unavailable, error))?;
        }
        if let (Self::Permanent(folder), Some(aggregator), None) =
            (self, &config.agent.aggregator, &config.spool.file)
        {
            let spool = spools::prepare(folder, aggregator)
                .with_context(|| format!("cannot take over the spool in {}", folder.display()))
                .map_err(|error| Failure::new(Exit::Unavailable, error))?;
            config.spool.file = Some(spool);
        }
        Ok(())
    }

    pub(crate) fn folder(&self) -> &Path {
        match self {
            Self::Permanent(folder) => folder,
            Self::Temporary(folder) => folder.path(),
        }
    }
}

/// Returns whether the agent runs custom programs.
fn has_programs(config: &AgentConfig) -> bool {
    config.models.iter().any(ModelConfig::is_program)
        || config.pipelines.iter().any(|pipeline| {
            pipeline.sensor.as_ref().is_some_and(SensorKind::is_program) || pipeline.actuator.is_program()
        })
}

/// Returns this user's folder for data that outlives a run.
fn state_root() -> Option<PathBuf> {
    let absolute_path = |variable: &str| {
        let path = std::env::var_os(variable).map(PathBuf::from);
        path.filter(|path| path.is_absolute())
    };
    // The XDG Base Directory Specification, version 0.8: relative paths are to be ignored.
    let state = absolute_path("XDG_STATE_HOME")
        .or_else(|| absolute_path("HOME").map(|home| home.join(".local/state")));
    state.map(|state| state.join("peernet"))
}
