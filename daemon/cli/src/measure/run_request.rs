//! Request to measure one run.

use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_actuators::ActuatorConfig;
use peernet_agent::AgentConfig;
use peernet_agent::config::PipelineConfig;
use peernet_analysis::record::{NetworkConfig, User};
use peernet_clock::Span;
use peernet_results::Overwrite;
use serde::{Deserialize, Serialize};

use crate::foreground::PeerWait;

/// Request to measure one run. `peernet measure --order` reads it as JSON.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunRequest {
    /// The agent, with one pipeline that has a limit.
    pub(crate) agent: AgentConfig,
    /// Title of figures and tables.
    pub(crate) title: String,
    /// Folder for the results.
    #[serde(with = "any_path")]
    pub(crate) folder: PathBuf,
    /// Treatment of existing results.
    pub(crate) overwrite: Overwrite,
    /// `true` if figures are to be drawn.
    #[serde(default)]
    pub(crate) plots: bool,
    /// The command that was typed.
    pub(crate) command: String,
    /// The network configuration file that the command names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) network_config: Option<NetworkConfig>,
    /// Number of this edge, if several edges send at the same time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) user: Option<User>,
    /// Description of the iterations that are warm-up.
    pub(crate) warm_up: String,
    /// Longest wait for an absent peer, before the run and during it; seconds. Default: 90.
    #[serde(default, rename = "patience_s", skip_serializing_if = "Option::is_none")]
    pub(crate) peer_timeout_s: Option<f64>,
    /// Actuator of the runs, if this request is for their trial. It is created and dropped before the trial, which runs
    /// without an actuator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) tried_actuator: Option<ActuatorConfig>,
}

impl RunRequest {
    /// Returns the pipeline.
    ///
    /// # Errors
    /// When there is not exactly one pipeline, or the pipeline has no limit (exit code 78).
    pub(super) fn pipeline(&self) -> Result<&PipelineConfig, Failure> {
        let invalid = |text: &str| Failure::new(Exit::Configuration, anyhow!("{text}"));
        match self.agent.pipelines.as_slice() {
            [pipeline] if !pipeline.limit.is_none() => Ok(pipeline),
            [_] => Err(invalid("the pipeline has no limit: a run in the foreground needs an end")),
            _ => Err(invalid("a run in the foreground has exactly one pipeline")),
        }
    }

    /// Returns the longest wait for an absent peer.
    pub(super) fn peer_timeout(&self) -> Span {
        self.peer_timeout_s.map_or(PeerWait::DEFAULT_TIMEOUT, Span::from_seconds_f64)
    }
}

/// Serialisation of a path as text, or as its bytes if it is not UTF-8: JSON has only text, and Linux allows any bytes.
mod any_path {
    use std::ffi::OsString;
    use std::path::{Path, PathBuf};

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum SerializedPath {
        Text(String),
        Bytes(OsString),
    }

    pub(super) fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
        match path.to_str() {
            Some(text) => text.serialize(to),
            None => path.as_os_str().serialize(to),
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
        Ok(match SerializedPath::deserialize(from)? {
            SerializedPath::Text(text) => text.into(),
            SerializedPath::Bytes(bytes) => bytes.into(),
        })
    }

    #[cfg(test)]
    mod tests {
        use std::os::unix::ffi::OsStringExt;

        use super::*;

        #[derive(Debug, PartialEq, Serialize, serde::Deserialize)]
        struct Holder(#[serde(with = "super")] PathBuf);

        #[test]
        fn paths_of_any_bytes_survive_serialisation() {
            for bytes in [&b"results/a"[..], b"res\xff\xfe"] {
                let path = Holder(OsString::from_vec(bytes.to_vec()).into());
                let text = serde_json::to_string(&path).expect("can be written");
                assert_eq!(serde_json::from_str::<Holder>(&text).expect("is understood"), path, "{text}");
            }
            let text = Holder("results/a".into());
            assert_eq!(serde_json::to_string(&text).expect("can be written"), "\"results/a\"");
        }
    }
}
