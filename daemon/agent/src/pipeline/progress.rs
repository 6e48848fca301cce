//! Numbers, episodes, warm-up and limits of a run. No I/O.

use std::num::{NonZeroU32, NonZeroU64};

use peernet_clock::{MonoTime, Span};

use crate::config::{Limit, PipelineConfig, WarmUp};

/// Position of an iteration in its run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Position {
    /// Number of the iteration; contiguous from 1.
    pub(crate) number: u64,
    /// Number of the episode, from 0.
    pub(crate) episode: u32,
    /// Step within the episode, from 0.
    pub(crate) step: u32,
    /// `true` if the iteration is left out of statistics.
    pub(crate) warm_up: bool,
}

/// Progress of a run.
#[derive(Debug)]
pub(crate) struct Progress {
    warm_up: WarmUp,
    episode_steps: Option<NonZeroU32>,
    limit: Limit,
    /// `true` if the run directly continues another: caches and connections are warm.
    warm: bool,
    given: u64,
    measured: u64,
    /// Intended start of the first iteration that is not warm-up.
    measuring_since: Option<MonoTime>,
}

impl Progress {
    /// Creates the progress of a new run; `warm` is `true` if it directly continues another.
    pub(crate) fn new(config: &PipelineConfig, warm: bool) -> Self {
        Self {
            warm_up: config.warm_up,
            episode_steps: config.episode_steps,
            limit: config.limit,
            warm,
            given: 0,
            measured: 0,
            measuring_since: None,
        }
    }

    /// Returns whether an iteration with the intended start `intended` would be beyond the limit.
    pub(crate) fn is_over(&self, intended: MonoTime) -> bool {
        let enough = self.limit.iterations.is_some_and(|limit| self.measured >= limit.get());
        let all = self.limit.total.is_some_and(|limit| self.given >= limit.get());
        let late = match (self.measuring_since, self.limit.duration_s) {
            (Some(since), Some(seconds)) => intended >= since + Span::from_seconds_f64(seconds),
            _ => false,
        };
        enough || all || late
    }

    /// Returns the number of iterations so far.
    pub(crate) const fn given(&self) -> u64 {
        self.given
    }

    /// Returns the number of iterations that the run was to have by its limits on iterations; the number so far if it
    /// has no such limit.
    pub(crate) fn planned_iterations(&self) -> u64 {
        let left = self.limit.iterations.map(|limit| limit.get().saturating_sub(self.measured));
        let counted = left.map(|left| left.saturating_add(self.given));
        counted.into_iter().chain(self.limit.total.map(NonZeroU64::get)).min().unwrap_or(self.given)
    }

    /// Assigns number, episode and step to the next iteration.
    pub(crate) fn place(&mut self, intended: MonoTime) -> Position {
        let index = self.given;
        let (episode, step) = match self.episode_steps {
            // Episode and step stop at their largest value; the number of the iteration is a u64 and continues.
            Some(steps) => {
                (saturate(index / u64::from(steps.get())), (index % u64::from(steps.get())) as u32)
            }
            None => (0, saturate(index)),
        };
        let cold = index < self.warm_up.iterations
            || self.episode_steps.is_some() && episode < self.warm_up.episodes;
        let settling = self.episode_steps.is_some() && step < self.warm_up.steps;
        let warm_up = cold && !self.warm || settling;
        self.given += 1;
        if !warm_up {
            self.measured += 1;
            self.measuring_since.get_or_insert(intended);
        }
        Position { number: self.given, episode, step, warm_up }
    }
}

fn saturate(number: u64) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress(keys: &str, warm: bool) -> Progress {
        let table = format!(
            "name = 'p'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
             placement = {{ kind = 'local', model = 'm' }}\n{keys}"
        );
        Progress::new(&toml::from_str(&table).expect("a pipeline"), warm)
    }

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn limit_excludes_warm_up() {
        let mut progress = progress("warm_up = { iterations = 2 }\nlimit = { iterations = 3 }", false);
        let mut warm_up = Vec::new();
        while !progress.is_over(at(0)) {
            warm_up.push(progress.place(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false, false, false]);
    }

    #[test]
    fn total_includes_warm_up() {
        let mut progress =
            progress("warm_up = { iterations = 2 }\nlimit = { total = 3, iterations = 9 }", false);
        let mut warm_up = Vec::new();
        while !progress.is_over(at(0)) {
            warm_up.push(progress.place(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false]);
    }

    #[test]
    fn planned_iterations_are_known_beforehand() {
        let planned_iterations = |keys: &str| {
            let mut progress = progress(keys, false);
            for _ in 0..7 {
                progress.place(at(0));
            }
            progress.planned_iterations()
        };
        assert_eq!(planned_iterations("warm_up = { iterations = 2 }\nlimit = { iterations = 30 }"), 32);
        assert_eq!(
            planned_iterations("warm_up = { iterations = 2 }\nlimit = { iterations = 30, total = 20 }"),
            20
        );
        assert_eq!(planned_iterations("limit = { duration_s = 9.0 }"), 7);
    }

    #[test]
    fn duration_begins_at_first_measured_iteration() {
        let mut progress = progress("warm_up = { iterations = 1 }\nlimit = { duration_s = 2.5 }", false);
        progress.place(at(10));
        assert!(!progress.is_over(at(1000)), "still warming up");
        assert_eq!(progress.place(at(20)), Position { number: 2, episode: 0, step: 1, warm_up: false });
        assert!(!progress.is_over(at(22)));
        assert!(progress.is_over(at(23)));
    }

    #[test]
    fn episodes_and_their_first_steps_warm_up() {
        let keys = "episode_steps = 3\nwarm_up = { iterations = 0, episodes = 1, steps = 1 }";
        let mut progress = progress(keys, false);
        let positions: Vec<_> = (0..7).map(|_| progress.place(at(0))).collect();
        let shape: Vec<_> =
            positions.iter().map(|place| (place.episode, place.step, place.warm_up)).collect();
        assert_eq!(
            shape,
            [
                (0, 0, true),
                (0, 1, true),
                (0, 2, true),
                (1, 0, true),
                (1, 1, false),
                (1, 2, false),
                (2, 0, true)
            ]
        );
        assert!(positions.iter().map(|place| place.number).eq(1..=7));
    }

    #[test]
    fn continuing_run_has_no_warm_up() {
        assert!(!progress("", true).place(at(0)).warm_up);
        assert!(progress("", false).place(at(0)).warm_up);
    }
}
