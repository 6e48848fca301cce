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

/// Counts the iterations of a run, assigns their positions, and knows when the run's limit is reached.
#[derive(Debug)]
pub(crate) struct Progress {
    warm_up: WarmUp,
    episode_steps: Option<NonZeroU32>,
    limit: Limit,
    /// `true` if the run directly continues another run. Caches and connections are then warm already.
    is_continuation: bool,
    /// Number of iterations so far.
    started_iterations: u64,
    /// Number of iterations so far that are not warm-up.
    measured_iterations: u64,
    /// Episode and step of the next iteration.
    next_step: (u32, u32),
    /// Intended start of the first iteration that is not warm-up.
    measuring_since: Option<MonoTime>,
}

impl Progress {
    /// Creates the progress of a new run. `is_continuation` is `true` if the run directly continues another run.
    pub(crate) fn new(config: &PipelineConfig, is_continuation: bool) -> Self {
        Self {
            warm_up: config.warm_up,
            episode_steps: config.episode_steps,
            limit: config.limit,
            is_continuation,
            started_iterations: 0,
            measured_iterations: 0,
            next_step: (0, 0),
            measuring_since: None,
        }
    }

    /// Returns whether an iteration with this intended start would exceed the run's limit.
    pub(crate) fn is_limit_reached(&self, intended: MonoTime) -> bool {
        let iterations_reached =
            self.limit.iterations.is_some_and(|limit| self.measured_iterations >= limit.get());
        let total_reached = self.limit.total.is_some_and(|limit| self.started_iterations >= limit.get());
        let duration_reached = match (self.measuring_since, self.limit.duration_s) {
            (Some(since), Some(limit)) => intended >= since + Span::from_seconds_f64(limit),
            _ => false,
        };
        let (episode, _) = self.next_step;
        let episodes_reached = self.limit.episodes.is_some_and(|limit| episode >= limit.get());
        iterations_reached || total_reached || duration_reached || episodes_reached
    }

    /// Returns the number of iterations so far.
    pub(crate) const fn started_iterations(&self) -> u64 {
        self.started_iterations
    }

    /// Returns the number of iterations after which the run reaches a limit on iterations; the number so far if the run
    /// has no such limit.
    pub(crate) fn planned_iterations(&self) -> u64 {
        let remaining =
            self.limit.iterations.map(|limit| limit.get().saturating_sub(self.measured_iterations));
        let by_iterations = remaining.map(|remaining| remaining.saturating_add(self.started_iterations));
        by_iterations
            .into_iter()
            .chain(self.limit.total.map(NonZeroU64::get))
            .min()
            .unwrap_or(self.started_iterations)
    }

    /// Assigns number, episode and step to the next iteration.
    pub(crate) fn assign_position(&mut self, intended: MonoTime) -> Position {
        let is_episode_warm_up = self.episode_steps.is_some() && self.next_step.1 < self.warm_up.steps;
        self.assign(intended, is_episode_warm_up)
    }

    /// Assigns number, episode and step to an iteration whose preparation failed. The iteration is not part of the
    /// warm-up of its episode.
    // Statistics leave out warm-up, but they must show that an episode could not begin.
    pub(crate) fn assign_unprepared_position(&mut self, intended: MonoTime) -> Position {
        let is_episode_warm_up = false;
        self.assign(intended, is_episode_warm_up)
    }

    fn assign(&mut self, intended: MonoTime, is_episode_warm_up: bool) -> Position {
        let (episode, step) = self.next_step;
        let warm_up = self.is_run_warm_up(episode) || is_episode_warm_up;
        self.started_iterations += 1;
        // A run of several years may have more episodes or steps than a u32 can count. The numbers then stay at the
        // largest value.
        self.next_step = match self.episode_steps {
            Some(steps) if step.saturating_add(1) >= steps.get() => (episode.saturating_add(1), 0),
            _ => (episode, step.saturating_add(1)),
        };
        if !warm_up {
            self.measured_iterations += 1;
            // The duration counts from the intended start, so that a late first iteration does not prolong the run.
            self.measuring_since.get_or_insert(intended);
        }
        Position { number: self.started_iterations, episode, step, warm_up }
    }

    /// Returns whether the next iteration is the first of its episode.
    pub(crate) const fn begins_episode(&self) -> bool {
        self.next_step.1 == 0
    }

    /// Returns whether the next iteration belongs to the warm-up at the start of the run, which has a number of
    /// iterations or of episodes.
    pub(crate) fn next_is_run_warm_up(&self) -> bool {
        self.is_run_warm_up(self.next_step.0)
    }

    /// Returns whether no further iteration of an episode starts.
    pub(crate) const fn has_passed_episode(&self, episode: u32) -> bool {
        self.next_step.0 > episode
    }

    /// Ends an episode before its last step: the next iteration is the first iteration of the next episode.
    pub(crate) fn end_episode(&mut self, episode: u32) {
        // Iterations of the next episode may have started before the actuator reported the end of this episode.
        if self.next_step.0 == episode {
            self.next_step = (episode.saturating_add(1), 0);
        }
    }

    /// Returns whether the next iteration, which belongs to `episode`, is within the warm-up at the start of the run.
    fn is_run_warm_up(&self, episode: u32) -> bool {
        let is_warm_up = self.started_iterations < self.warm_up.iterations
            || self.episode_steps.is_some() && episode < self.warm_up.episodes;
        // A continuation has no warm-up at its start. The warm-up of each episode is not affected.
        is_warm_up && !self.is_continuation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress(keys: &str) -> Progress {
        let is_continuation = false;
        Progress::new(&pipeline(keys), is_continuation)
    }

    fn pipeline(keys: &str) -> PipelineConfig {
        let table = format!(
            "name = 'p'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
             placement = {{ kind = 'local', model = 'm' }}\n{keys}"
        );
        toml::from_str(&table).expect("a pipeline")
    }

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn limit_of_iterations_excludes_warm_up() {
        let mut progress = progress("warm_up = { iterations = 2 }\nlimit = { iterations = 3 }");
        let mut warm_up = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            warm_up.push(progress.assign_position(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false, false, false]);
    }

    #[test]
    fn limit_of_total_includes_warm_up() {
        let mut progress = progress("warm_up = { iterations = 2 }\nlimit = { total = 3, iterations = 9 }");
        let mut warm_up = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            warm_up.push(progress.assign_position(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false]);
    }

    #[test]
    fn number_of_iterations_follows_from_configuration() {
        for keys in [
            "limit = { iterations = 100 }",
            "limit = { iterations = 3, total = 4 }",
            "episode_steps = 10\nwarm_up = { iterations = 0, steps = 1 }\nlimit = { iterations = 100 }",
            "episode_steps = 10\nwarm_up = { iterations = 25, episodes = 2, steps = 3 }\nlimit = { iterations = 7 }",
            "episode_steps = 10\nwarm_up = { iterations = 21, episodes = 2, steps = 3 }\nlimit = { iterations = 7 }",
        ] {
            let mut progress = progress(keys);
            while !progress.is_limit_reached(at(0)) {
                progress.assign_position(at(0));
            }
            assert_eq!(pipeline(keys).total_iterations(), Some(progress.started_iterations()), "{keys}");
        }
        let keys = "episode_steps = 2\nwarm_up = { iterations = 0, steps = 2 }\nlimit = { iterations = 1 }";
        assert_eq!(pipeline(keys).total_iterations(), None, "all iterations are warm-up");
    }

    #[test]
    fn planned_iterations_follow_from_limits() {
        let planned_iterations = |keys: &str| {
            let mut progress = progress(keys);
            for _ in 0..7 {
                progress.assign_position(at(0));
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
        let mut progress = progress("warm_up = { iterations = 1 }\nlimit = { duration_s = 2.5 }");
        progress.assign_position(at(10));
        assert!(!progress.is_limit_reached(at(1000)), "the only iteration so far is warm-up");
        assert_eq!(
            progress.assign_position(at(20)),
            Position { number: 2, episode: 0, step: 1, warm_up: false }
        );
        assert!(!progress.is_limit_reached(at(22)));
        assert!(progress.is_limit_reached(at(23)));
    }

    #[test]
    fn first_episode_and_first_steps_are_warm_up() {
        let keys = "episode_steps = 3\nwarm_up = { iterations = 0, episodes = 1, steps = 1 }";
        let mut progress = progress(keys);
        let positions: Vec<_> = (0..7).map(|_| progress.assign_position(at(0))).collect();
        let steps: Vec<_> =
            positions.iter().map(|position| (position.episode, position.step, position.warm_up)).collect();
        assert_eq!(
            steps,
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
        assert!(positions.iter().map(|position| position.number).eq(1..=7));
    }

    #[test]
    fn reported_end_of_episode_begins_next_episode() {
        let mut progress = progress("episode_steps = 3\nlimit = { episodes = 3 }");
        let mut steps = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            let begins = progress.begins_episode();
            let position = progress.assign_position(at(0));
            assert_eq!(begins, position.step == 0);
            steps.push((position.episode, position.step));
            // An end is reported after the last step of the first episode, and after the second step of the second
            // episode.
            if [(0, 2), (1, 1)].contains(&(position.episode, position.step)) {
                progress.end_episode(position.episode);
                assert!(
                    progress.has_passed_episode(position.episode)
                        && !progress.has_passed_episode(position.episode + 1)
                );
            }
        }
        assert_eq!(steps, [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]);
    }

    #[test]
    fn without_episode_steps_only_feedback_ends_episodes() {
        let mut progress = progress("");
        for number in 0..100 {
            assert_eq!((progress.assign_position(at(0)).step, progress.begins_episode()), (number, false));
        }
        progress.end_episode(0);
        let position = progress.assign_position(at(0));
        assert_eq!((position.episode, position.step), (1, 0));
    }

    #[test]
    fn continuing_run_has_no_warm_up_at_start() {
        let is_continuation = true;
        assert!(!Progress::new(&pipeline(""), is_continuation).assign_position(at(0)).warm_up);
        assert!(progress("").assign_position(at(0)).warm_up);
    }
}
