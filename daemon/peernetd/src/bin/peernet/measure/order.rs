//! What is to be measured.

use std::path::PathBuf;

use anyhow::anyhow;
use peernet_agent::AgentConfig;
use peernet_agent::config::PipelineConfig;
use peernet_clock::Span;
use peernet_report::results::Overwrite;
use peernetd::exit::{Exit, Failure};
use serde::{Deserialize, Serialize};

use crate::foreground::Patience;

/// One run.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Order {
    /// The agent, with one pipeline that has a limit.
    pub(crate) agent: AgentConfig,
    /// For people: the title of figures and tables.
    pub(crate) title: String,
    /// Where the results go.
    pub(crate) folder: PathBuf,
    /// What becomes of results that are there already.
    pub(crate) overwrite: Overwrite,
    /// Whether to draw the figures.
    #[serde(default)]
    pub(crate) plots: bool,
    /// The command that was typed.
    pub(crate) command: String,
    /// Which iterations are warm-up, in words.
    pub(crate) warm_up: String,
    /// How long a peer that is away is waited for, before the run and during it; seconds. Default: 90.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) patience_s: Option<f64>,
}

impl Order {
    /// The pipeline.
    ///
    /// # Errors
    /// When there is not exactly one, or it would run for ever (78).
    pub(super) fn pipeline(&self) -> Result<&PipelineConfig, Failure> {
        let wrong = |text: &str| Failure::new(Exit::Configuration, anyhow!("{text}"));
        match self.agent.pipelines.as_slice() {
            [pipeline] if !pipeline.limit.is_none() => Ok(pipeline),
            [_] => Err(wrong("the pipeline has no limit: a run in the foreground needs an end")),
            _ => Err(wrong("a run in the foreground has exactly one pipeline")),
        }
    }

    /// How long a peer that is away is waited for.
    pub(super) fn patience(&self) -> Span {
        self.patience_s.map_or(Patience::USUAL, Span::from_seconds_f64)
    }
}
