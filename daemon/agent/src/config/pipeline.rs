//! The table `[[pipeline]]`.

use std::num::{NonZeroU32, NonZeroU64, NonZeroUsize};
use std::time::Duration;

use peernet_actuators::{ActuatorConfig, ActuatorKind};
use peernet_logger::Slug;
use peernet_networks::{Address, NetworkKind, SessionSettings};
use peernet_sensors::{SensorConfig, SensorKind, TransformConfig};
use peernet_stream::ExperimentPosition;
use serde::{Deserialize, Serialize};

use super::ObserveConfig;

/// `[[pipeline]]`: sensor, transforms, placement and actuator, and how often they run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PipelineConfig {
    /// Name for people, unique on this host.
    pub name: Slug,
    /// Source of the samples: `{ kind = "images", path = "…" }` and so on. Required, except where a system is only
    /// observed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorConfig>,
    /// Transforms that are applied to each sample, in this order, before it is sent or given to a model. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub transforms: Vec<TransformConfig>,
    /// Place of computation: `{ kind = "local", model = "…" }`, `{ kind = "remote", peer = "tcp://host:5551", model =
    /// "…" }`, `{ kind = "none" }` to study the sensor alone, or `{ kind = "observe", input = "/a", output = "/b" }`
    /// to observe a running ROS system.
    pub placement: PlacementConfig,
    /// Schedule by which iterations start. Default: `{ mode = "closed" }`.
    #[serde(default)]
    pub load: LoadConfig,
    /// Maximum number of iterations in flight; with `mode = "closed"` it is always one. The same number of further
    /// starts may wait. If one more start becomes due, the oldest waiting start is skipped and counted
    /// (`skipped-starts`). At most 4096. Default: 4.
    #[serde(default = "default_max_in_flight")]
    pub max_in_flight: NonZeroUsize,
    /// Longest wait for an answer; milliseconds, up to a day. An iteration whose answer comes later is a `timeout`.
    /// Default: 5000.
    #[serde(default = "default_timeout_ms")]
    pub timeout_ms: NonZeroU64,
    /// Deadline of an iteration, from its intended start to its end; milliseconds, up to `timeout_ms`. An iteration
    /// that takes longer, or that fails, has missed its deadline. Default: no deadline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline_ms: Option<NonZeroU64>,
    /// Iterations that are recorded but left out of statistics.
    #[serde(default)]
    pub warm_up: WarmUp,
    /// Maximum number of iterations per episode; the feedback of the actuator may end an episode earlier. Default: only
    /// the actuator ends episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episode_steps: Option<NonZeroU32>,
    /// Limit at which the pipeline stops by itself. Default: none.
    #[serde(default)]
    pub limit: Limit,
    /// Actuator that receives each answer. Default: none.
    #[serde(default)]
    pub actuator: ActuatorConfig,
    /// Whether the pipeline starts with the agent. Default: `boot`.
    #[serde(default)]
    pub start: StartMode,
    /// Position of the pipeline in an experiment; set by `peernet run`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub experiment: Option<ExperimentPosition>,
}

impl PipelineConfig {
    /// Returns a copy without the values of `env`, which may be secret. The copy still contains the arguments of
    /// programs.
    pub(crate) fn redacted(&self) -> Self {
        let mut redacted = self.clone();
        if let Some(sensor) = &mut redacted.sensor {
            sensor.hide_secrets();
        }
        redacted.actuator.hide_secrets();
        redacted
    }
}

/// Place where a pipeline computes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PlacementConfig {
    /// A model of this host.
    Local {
        /// Name of one of this host's `[[model]]`.
        model: Slug,
    },
    /// A model of a peer, over a network.
    Remote(Box<RemoteConfig>),
    /// No model: only the sensor and its transforms run, without answers. The check of the configuration refuses an
    /// actuator with it.
    // serde refuses unknown keys of a variant with braces, and ignores unknown keys of a variant without braces.
    None {},
    /// A running ROS system that is only observed.
    Observe(ObserveConfig),
}

/// `placement = { kind = "remote", … }`: a model of a peer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteConfig {
    /// Address in the peer's `[serve] listen`: `tcp://host:port`. Its scheme selects the network.
    pub peer: Address,
    /// Kind of network, which must match the scheme of `peer`. Default: the kind that the scheme selects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkKind>,
    /// Name of one of the peer's models. Default: the peer's only model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<Slug>,
    /// Device that the model must run on. Default: the device that the peer has configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Time limits and bounds of the session.
    #[serde(default)]
    pub session: SessionSettings,
}

impl PlacementConfig {
    /// Returns the name of the model, if one is configured.
    pub fn model(&self) -> Option<&Slug> {
        match self {
            Self::Local { model } => Some(model),
            Self::Remote(remote) => remote.model.as_ref(),
            Self::None {} | Self::Observe(_) => None,
        }
    }
}

/// Schedule by which iterations start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mode", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LoadConfig {
    /// Each iteration starts after the previous one was answered.
    // With braces for the same reason as `PlacementConfig::None`.
    Closed {},
    /// Iterations start at a fixed rate, whether or not earlier iterations are complete. Latency counts from the
    /// intended start.
    Rate {
        /// Starts per second: at least one a year, at most 100,000.
        hz: f64,
    },
    /// Iterations start at random times with exponentially distributed intervals (a Poisson process), like the requests
    /// of many independent clients.
    Poisson {
        /// Starts per second on average: at least one a year, at most 100,000.
        hz: f64,
        /// Seed of the intervals; equal seeds give equal intervals. Default: 0.
        #[serde(default)]
        seed: u64,
    },
}

impl Default for LoadConfig {
    fn default() -> Self {
        Self::Closed {}
    }
}

impl LoadConfig {
    /// Returns the configured starts per second; `None` for a closed loop.
    pub fn hz(&self) -> Option<f64> {
        match *self {
            Self::Closed {} => None,
            Self::Rate { hz } | Self::Poisson { hz, .. } => Some(hz),
        }
    }

    /// Returns the schedule as a text: `closed`, `5 Hz`, `Poisson, 5 Hz`.
    pub fn describe(&self) -> String {
        match self {
            Self::Closed {} => "closed".to_owned(),
            Self::Rate { hz } => format!("{hz} Hz"),
            Self::Poisson { hz, .. } => format!("Poisson, {hz} Hz"),
        }
    }
}

/// Iterations that are recorded but left out of statistics, because caches, connections and models are not warm yet. An
/// iteration is warm-up if any of these conditions holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmUp {
    /// Number of iterations at the start of the run. Default: 5.
    pub iterations: u64,
    /// Number of episodes at the start of the run; needs `episode_steps`. Default: 0.
    pub episodes: u32,
    /// Number of steps at the start of every episode; needs `episode_steps`. Default: 0.
    pub steps: u32,
}

impl Default for WarmUp {
    fn default() -> Self {
        Self { iterations: 5, episodes: 0, steps: 0 }
    }
}

/// Limits at which a pipeline stops by itself; it stops at the first limit that is reached. Without a limit it runs for
/// ever, and a new run starts at each midnight UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limit {
    /// Number of iterations, without the warm-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<NonZeroU64>,
    /// Number of iterations, including the warm-up. If all of these iterations are warm-up, the run
    /// has rows but no statistics.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub total: Option<NonZeroU64>,
    /// Number of episodes, including those of the warm-up; needs `episode_steps`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub episodes: Option<NonZeroU32>,
    /// Duration in seconds, from the start of the first iteration that is not warm-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
}

impl Limit {
    /// Returns whether no limit is set.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Whether a pipeline starts with the agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartMode {
    /// The pipeline starts with the agent.
    #[default]
    Boot,
    /// The pipeline is checked and shown, but not started.
    Manual,
}

impl PipelineConfig {
    /// Returns the schedule as a text. The schedule of an observed system is unknown.
    pub fn load_text(&self) -> String {
        match &self.placement {
            PlacementConfig::Observe(_) => "observed".to_owned(),
            _ => self.load.describe(),
        }
    }

    /// Returns the number of iterations after which a run ends if no episode ends early, including the warm-up; `None`
    /// without a limit on iterations.
    pub fn total_iterations(&self) -> Option<u64> {
        let with_warm_up =
            self.limit.iterations.and_then(|iterations| self.iterations_until_measured(iterations));
        with_warm_up.into_iter().chain(self.limit.total.map(NonZeroU64::get)).min()
    }

    /// Returns the number of iterations, including the warm-up, of a run up to its measured iteration `measured` (one that
    /// is not warm-up), if no episode ends early; `None` if all iterations are warm-up.
    pub fn iterations_until_measured(&self, measured: NonZeroU64) -> Option<u64> {
        let WarmUp { iterations, episodes, steps } = self.warm_up;
        let Some(episode_steps) = self.episode_steps else {
            return Some(iterations.saturating_add(measured.get()));
        };
        let (episode_steps, steps) = (u64::from(episode_steps.get()), u64::from(steps));
        let measured_steps = episode_steps.checked_sub(steps).filter(|measured_steps| *measured_steps > 0)?;
        let start = iterations.max(episode_steps.saturating_mul(episodes.into()));
        // The measured iterations are numbered as if the run had no warm-up at its start.
        let left_out = start / episode_steps * measured_steps + (start % episode_steps).saturating_sub(steps);
        let last = left_out.saturating_add(measured.get() - 1);
        let whole_episodes = (last / measured_steps).saturating_mul(episode_steps);
        Some(whole_episodes.saturating_add(steps + last % measured_steps + 1))
    }

    /// Returns the longest wait for an answer.
    pub fn timeout(&self) -> Duration {
        Duration::from_millis(self.timeout_ms.get())
    }

    /// Returns the deadline of an iteration, if one is configured.
    pub fn deadline(&self) -> Option<Duration> {
        self.deadline_ms.map(|deadline| Duration::from_millis(deadline.get()))
    }
}

const fn default_max_in_flight() -> NonZeroUsize {
    const { NonZeroUsize::new(4).expect("above 0") }
}

const fn default_timeout_ms() -> NonZeroU64 {
    const { NonZeroU64::new(5000).expect("above 0") }
}
