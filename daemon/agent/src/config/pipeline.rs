//! `[[pipeline]]`

use std::num::{NonZeroU32, NonZeroU64, NonZeroUsize};
use std::time::Duration;

use peernet_actuators::{ActuatorConfig, ActuatorKind};
use peernet_logger::Slug;
use peernet_networks::{Address, NetworkKind, SessionSettings};
use peernet_sensors::{SensorConfig, SensorKind, TransformConfig};
use peernet_stream::ExperimentPlace;
use serde::{Deserialize, Serialize};

use super::ObserveConfig;

/// `[[pipeline]]`: sensor → transforms → placement → actuator, and how often.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PipelineConfig {
    /// Name for people, unique on this host.
    pub name: Slug,
    /// Where samples come from: `{ kind = "images", path = "…" }` and so on. Required, except where a system is only
    /// observed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorConfig>,
    /// What is done with each sample before it is sent or computed on, in order. Default: nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub transforms: Vec<TransformConfig>,
    /// Where it computes: `{ kind = "local", model = "…" }`,
    /// `{ kind = "remote", peer = "tcp://host:5551", model = "…" }`, `{ kind = "none" }` to study the sensor alone, or
    /// `{ kind = "observe", input = "/a", output = "/b" }` to observe a ROS system that runs already.
    pub placement: PlacementConfig,
    /// When iterations begin. Default: `{ mode = "closed" }`.
    #[serde(default)]
    pub load: LoadConfig,
    /// Iterations that may be under way at once, except with `mode = "closed"`, which has one. As many starts
    /// again may wait; older ones are skipped and counted (`skipped-starts`). At most 4096. Default: 4.
    #[serde(default = "four")]
    pub max_in_flight: NonZeroUsize,
    /// How long to wait for an answer; milliseconds, up to a day. Later ones count as `timeout`. Default: 5000.
    #[serde(default = "five_seconds")]
    pub timeout_ms: NonZeroU64,
    /// How long an iteration may take from its intended start to its end; milliseconds, up to `timeout_ms`. One that takes
    /// longer, or has no answer, missed its deadline. Default: no deadline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline_ms: Option<NonZeroU64>,
    /// Iterations that are kept but left out of statistics.
    #[serde(default)]
    pub warm_up: WarmUp,
    /// Iterations per episode. Default: one episode without end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episode_steps: Option<NonZeroU32>,
    /// When to stop. Default: never.
    #[serde(default)]
    pub limit: Limit,
    /// What is done with each answer. Default: nothing.
    #[serde(default)]
    pub actuator: ActuatorConfig,
    /// Whether it starts with the agent. Default: `boot`.
    #[serde(default)]
    pub start: StartMode,
    /// Its place in an experiment; `peernet run` fills it in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub experiment: Option<ExperimentPlace>,
}

impl PipelineConfig {
    /// Without the values of `env`, which may be secret. The arguments of programs are still there.
    pub(crate) fn publishable(&self) -> Self {
        let mut told = self.clone();
        if let Some(sensor) = &mut told.sensor {
            sensor.hide_secrets();
        }
        told.actuator.hide_secrets();
        told
    }
}

/// Where a pipeline computes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PlacementConfig {
    /// On this host.
    Local {
        /// Name of one of this host's `[[model]]`.
        model: Slug,
    },
    /// On a peer, over a network.
    Remote(Box<RemoteConfig>),
    /// Nowhere: the sensor and its transforms alone, without answers. `actuator` does nothing then.
    None {},
    /// In a ROS system that runs already and is only observed.
    Observe(ObserveConfig),
}

/// `placement = { kind = "remote", … }`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteConfig {
    /// An address of the peer's `[serve] listen`: `tcp://host:port`. Its scheme selects the network.
    pub peer: Address,
    /// Kind of network, which must be that of `peer`. Default: whatever `peer` selects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkKind>,
    /// Name of one of the peer's models. Default: the only one that the peer offers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<Slug>,
    /// The device that the model must run on. Default: whatever the peer has configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Time limits and bounds of the session.
    #[serde(default)]
    pub session: SessionSettings,
}

impl PlacementConfig {
    /// The model's name, where there is one.
    pub fn model(&self) -> Option<&Slug> {
        match self {
            Self::Local { model } => Some(model),
            Self::Remote(remote) => remote.model.as_ref(),
            Self::None {} | Self::Observe(_) => None,
        }
    }
}

/// When iterations begin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mode", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LoadConfig {
    /// The next one after the answer to the last.
    Closed {},
    /// At a fixed rate, whether or not earlier ones are done. Latency counts from the intended start.
    Rate {
        /// Starts per second: at least one a year, at most 100,000.
        hz: f64,
    },
    /// At random moments: exponentially distributed gaps, as of many independent askers.
    Poisson {
        /// Starts per second on average: at least one a year, at most 100,000.
        hz: f64,
        /// Equal seeds give equal gaps. Default: 0.
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
    /// Starts per second, where they are set.
    pub fn hz(&self) -> Option<f64> {
        match *self {
            Self::Closed {} => None,
            Self::Rate { hz } | Self::Poisson { hz, .. } => Some(hz),
        }
    }

    /// In words: `closed`, `5 Hz`, `Poisson, 5 Hz`.
    pub fn describe(&self) -> String {
        match self {
            Self::Closed {} => "closed".to_owned(),
            Self::Rate { hz } => format!("{hz} Hz"),
            Self::Poisson { hz, .. } => format!("Poisson, {hz} Hz"),
        }
    }
}

/// Iterations that are kept, but flagged and left out of statistics: caches fill, connections open up, models
/// compile. An iteration is warm-up when any of these says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmUp {
    /// The first so many iterations. Default: 5.
    pub iterations: u64,
    /// The first so many episodes; needs `episode_steps`. Default: 0.
    pub episodes: u32,
    /// The first so many steps of every episode; needs `episode_steps`. Default: 0.
    pub steps: u32,
}

impl Default for WarmUp {
    fn default() -> Self {
        Self { iterations: 5, episodes: 0, steps: 0 }
    }
}

/// When a pipeline stops by itself: at whichever comes first. Without a limit it runs for ever, and a new run
/// begins at midnight UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limit {
    /// After this many iterations; those of the warm-up do not count.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<NonZeroU64>,
    /// After this many iterations, those of the warm-up among them: what the published `--iterations` counts.
    /// With a warm-up that is as long there are rows, but no statistics.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub total: Option<NonZeroU64>,
    /// So many seconds after the first iteration that is not warm-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
}

impl Limit {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Whether a pipeline starts with the agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartMode {
    /// As soon as the agent is up.
    #[default]
    Boot,
    /// Checked and shown, but not started.
    Manual,
}

impl PipelineConfig {
    /// The load in words; an observed system has its own.
    pub fn load_in_words(&self) -> String {
        match &self.placement {
            PlacementConfig::Observe(_) => "observed".to_owned(),
            _ => self.load.describe(),
        }
    }

    /// How long to wait for an answer.
    pub fn timeout(&self) -> Duration {
        Duration::from_millis(self.timeout_ms.get())
    }

    /// How long an iteration may take.
    pub fn deadline(&self) -> Option<Duration> {
        self.deadline_ms.map(|deadline| Duration::from_millis(deadline.get()))
    }
}

const fn four() -> NonZeroUsize {
    const { NonZeroUsize::new(4).expect("above 0") }
}

const fn five_seconds() -> NonZeroU64 {
    const { NonZeroU64::new(5000).expect("above 0") }
}
