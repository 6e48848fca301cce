//! The tables `[experiment]` and `[network]`.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroU64};
use std::path::PathBuf;

use peernet_agent::config::{Limit, WarmUp};
use peernet_logger::Slug;
use peernet_networks::Address;
use serde::{Deserialize, Serialize};
use toml::Value;

/// Maximum number of concurrent edges. Each edge is a process with its own sockets and clock
/// probes, and with a model of its own if it computes itself. More processes on one host would
/// measure that host, and not the network or the server.
const MAX_USERS: u32 = 64;
/// Longest run in seconds: a year.
const MAX_RUN_S: f64 = 365.0 * 86_400.0;
/// Longest wait for a peer in seconds: a day, as for `--patience`.
const MAX_PATIENCE_S: f64 = 86_400.0;

/// `[experiment]`: number, order and length of the runs.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::run) struct Experiment {
    /// Name for people, and of the pipeline on dashboards.
    pub(in crate::run) name: Slug,
    /// Seed of order and payloads. Default: 1.
    #[serde(default = "one_seed")]
    pub(in crate::run) seed: u64,
    /// Number of times that each configuration is measured. Default: 1.
    #[serde(default = "one")]
    pub(in crate::run) repeats: NonZeroU32,
    /// Order of the runs. Default: `random`.
    #[serde(default)]
    pub(in crate::run) order: Order,
    /// `true` if each run draws its figures. Default: true.
    #[serde(default = "enabled")]
    pub(in crate::run) plots: bool,
    /// Aggregator to which the runs are streamed as well: `tcp://host:port`. Default: none.
    #[serde(default)]
    pub(super) aggregator: Option<Address>,
    /// Excluded combinations. Each table has names of axes and, for each axis, the labels that are excluded together.
    #[serde(default)]
    pub(super) exclude: Vec<BTreeMap<String, Value>>,
    /// Episodes of each run; needs `episode_steps`.
    #[serde(default)]
    episodes: Option<NonZeroU32>,
    /// Iterations of each episode.
    #[serde(default)]
    pub(super) episode_steps: Option<NonZeroU32>,
    /// Iterations that are left out of statistics.
    #[serde(default)]
    warm_up: Option<WarmUp>,
    /// Number of iterations of each run after its warm-up.
    #[serde(default)]
    iterations: Option<NonZeroU64>,
    /// Duration of each run after its warm-up, seconds.
    #[serde(default)]
    duration_s: Option<f64>,
    /// Number of users: edges that use the cloud at the same time, each in a separate process. Default: 1.
    #[serde(default = "one")]
    pub(in crate::run) users: NonZeroU32,
    /// Longest wait for an absent peer; seconds.
    #[serde(default)]
    pub(in crate::run) patience_s: Option<f64>,
}

/// Order of the runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::run) enum Order {
    /// Each repeat of the whole matrix is shuffled by the seed: changes over time affect all configurations.
    #[default]
    Random,
    /// Order of the file.
    Declared,
}

/// `[network]`: the file with the names of peers.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Network {
    /// Path of the network configuration of the paper, which has the addresses of devices.
    pub(super) config: PathBuf,
}

/// A number of `[experiment]` that is too small or too large; the text begins with the key.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub(super) enum RangeError {
    #[error(
        "experiment.users: {0} is too many; at most {MAX_USERS} edges, each in its own process, can run at the same time"
    )]
    Users(u32),
    #[error("experiment.duration_s: {0:?} is not a number of seconds above 0 and up to {MAX_RUN_S}")]
    Duration(f64),
    #[error("experiment.patience_s: {0:?} is not a number of seconds from 0 to {MAX_PATIENCE_S}")]
    Patience(f64),
}

/// A run without a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum LimitError {
    #[error("episodes needs episode_steps, the length of an episode")]
    EpisodeSteps,
    #[error("a run has no limit; set episodes and episode_steps, iterations, or duration_s")]
    Endless,
}

impl Experiment {
    /// Checks the ranges of its numbers.
    ///
    /// # Errors
    /// When a number is outside its range.
    pub(super) fn check(&self) -> Result<(), RangeError> {
        let users = self.users.get();
        if users > MAX_USERS {
            return Err(RangeError::Users(users));
        }
        if let Some(seconds) = self.duration_s.filter(|seconds| !(*seconds > 0.0 && *seconds <= MAX_RUN_S)) {
            return Err(RangeError::Duration(seconds));
        }
        if let Some(seconds) = self.patience_s.filter(|seconds| !(0.0..=MAX_PATIENCE_S).contains(seconds)) {
            return Err(RangeError::Patience(seconds));
        }
        Ok(())
    }

    /// Returns the limit of a run.
    ///
    /// # Errors
    /// When the table has no limit.
    pub(super) fn limit(&self) -> Result<Limit, LimitError> {
        let total = match (self.episodes, self.episode_steps) {
            (Some(episodes), Some(steps)) => Some(NonZeroU64::from(episodes).saturating_mul(steps.into())),
            (Some(_), None) => return Err(LimitError::EpisodeSteps),
            (None, _) => None,
        };
        let limit =
            Limit { iterations: self.iterations, total, duration_s: self.duration_s, ..Limit::default() };
        if limit.is_none() {
            return Err(LimitError::Endless);
        }
        Ok(limit)
    }

    /// Returns the number of episodes of a run.
    pub(super) const fn episodes(&self) -> Option<NonZeroU32> {
        self.episodes
    }

    /// Returns the iterations that are left out of statistics. Default: with episodes, the warm-up
    /// of the paper; otherwise the usual five iterations.
    pub(super) fn warm_up(&self) -> WarmUp {
        let default = match self.episodes {
            Some(_) => WarmUp { iterations: 0, episodes: 1, steps: 1 },
            None => WarmUp::default(),
        };
        self.warm_up.unwrap_or(default)
    }
}

/// Describes which iterations are warm-up.
pub(super) fn describe_warm_up(warm_up: &WarmUp) -> String {
    let count = |number: u64, noun: &str| match number {
        0 => None,
        1 => Some(format!("the first {noun}")),
        many => Some(format!("the first {many} {noun}s")),
    };
    let rules = [
        count(warm_up.iterations, "iteration"),
        count(warm_up.episodes.into(), "episode"),
        count(warm_up.steps.into(), "step").map(|steps| format!("{steps} of each episode")),
    ];
    let rules: Vec<String> = rules.into_iter().flatten().collect();
    if rules.is_empty() { "none".to_owned() } else { rules.join(" and ") }
}

const fn one_seed() -> u64 {
    1
}

const fn one() -> NonZeroU32 {
    NonZeroU32::MIN
}

const fn enabled() -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Experiment {
        toml::from_str(&format!("name = 'e'\n{text}")).expect("it is a table of [experiment]")
    }

    #[test]
    fn default_warm_up_depends_on_episodes() {
        let paper = read("episodes = 30\nepisode_steps = 30");
        assert_eq!(paper.limit().expect("there is one").total.map(NonZeroU64::get), Some(900));
        assert_eq!(
            describe_warm_up(&paper.warm_up()),
            "the first episode and the first step of each episode"
        );
        let other = read("iterations = 10\nwarm_up = { iterations = 2 }");
        assert_eq!(describe_warm_up(&other.warm_up()), "the first 2 iterations");
        assert_eq!(describe_warm_up(&read("iterations = 10").warm_up()), "the first 5 iterations");
    }

    #[test]
    fn run_without_limit_is_refused() {
        assert_eq!(read("").limit().expect_err("endless"), LimitError::Endless);
        assert_eq!(read("episodes = 3").limit().expect_err("endless"), LimitError::EpisodeSteps);
        assert!(read("duration_s = 3.5").limit().is_ok());
    }

    #[test]
    fn numbers_outside_range_are_refused() {
        for fine in ["users = 64", "duration_s = 0.5", "patience_s = 0", "patience_s = 86400.0"] {
            assert_eq!(read(fine).check(), Ok(()), "{fine}");
        }
        for (wrong, message) in [
            ("users = 65", "experiment.users: 65 is too many"),
            ("duration_s = 0.0", "experiment.duration_s: 0.0 is not"),
            ("duration_s = 1e308", "experiment.duration_s: 1e308 is not"),
            ("duration_s = nan", "experiment.duration_s: NaN is not"),
            ("patience_s = -1", "experiment.patience_s: -1.0 is not"),
            ("patience_s = 1e300", "experiment.patience_s: 1e300 is not"),
            ("patience_s = inf", "experiment.patience_s: inf is not"),
        ] {
            let error = read(wrong).check().expect_err(wrong);
            assert!(error.to_string().starts_with(message), "{error}");
        }
    }
}
