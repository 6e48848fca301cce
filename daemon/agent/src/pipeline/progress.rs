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
    /// `true` if the run directly continues another. Caches and connections are warm then.
    is_continuation: bool,
    /// Number of iterations so far.
    started: u64,
    /// Number of iterations so far that are not warm-up.
    measured: u64,
    /// Episode and step of the next iteration.
    next: (u32, u32),
    /// Intended start of the first iteration that is not warm-up.
    measuring_since: Option<MonoTime>,
}

impl Progress {
    /// Creates the progress of a new run; `is_continuation` is `true` if it directly continues another.
    pub(crate) fn new(config: &PipelineConfig, is_continuation: bool) -> Self {
        Self {
            warm_up: config.warm_up,
            episode_steps: config.episode_steps,
            limit: config.limit,
            is_continuation,
            started: 0,
            measured: 0,
            next: (0, 0),
            measuring_since: None,
        }
    }

    /// Returns whether an iteration with this intended start would exceed the run's limit.
    pub(crate) fn is_limit_reached(&self, intended: MonoTime) -> bool {
        let iterations_reached = self.limit.iterations.is_some_and(|limit| self.measured >= limit.get());
        let total_reached = self.limit.total.is_some_and(|limit| self.started >= limit.get());
        let duration_reached = match (self.measuring_since, self.limit.duration_s) {
            (Some(since), Some(seconds)) => intended >= since + Span::from_seconds_f64(seconds),
            _ => false,
        };
        let (episode, _) = self.next;
        let episodes_reached = self.limit.episodes.is_some_and(|limit| episode >= limit.get());
        iterations_reached || total_reached || duration_reached || episodes_reached
    }

    /// Returns the number of iterations so far.
    pub(crate) const fn started(&self) -> u64 {
        self.started
    }

    /// Returns the number of iterations that the run has by its limits on iterations; the number so far if it has no
    /// such limit.
    pub(crate) fn planned_iterations(&self) -> u64 {
        let remaining = self.limit.iterations.map(|limit| limit.get().saturating_sub(self.measured));
        let by_iterations = remaining.map(|remaining| remaining.saturating_add(self.started));
        by_iterations.into_iter().chain(self.limit.total.map(NonZeroU64::get)).min().unwrap_or(self.started)
    }

    /// Assigns number, episode and step to the next iteration.
    pub(crate) fn assign_position(&mut self, intended: MonoTime) -> Position {
        let is_episode_start = self.episode_steps.is_some() && self.next.1 < self.warm_up.steps;
        self.assign(intended, is_episode_start)
    }

    /// Assigns number, episode and step to an iteration whose preparation failed. It is no warm-up of its episode.
    // Otherwise no count of a run would show that an episode could not begin.
    pub(crate) fn assign_unprepared_position(&mut self, intended: MonoTime) -> Position {
        self.assign(intended, false)
    }

    fn assign(&mut self, intended: MonoTime, is_episode_warm_up: bool) -> Position {
        let (episode, step) = self.next;
        let warm_up = self.is_run_warm_up(episode) || is_episode_warm_up;
        self.started += 1;
        // A u32 can hold neither the episode nor the step of a run of years: they stop at the largest value.
        self.next = match self.episode_steps {
            Some(steps) if step.saturating_add(1) >= steps.get() => (episode.saturating_add(1), 0),
            _ => (episode, step.saturating_add(1)),
        };
        if !warm_up {
            self.measured += 1;
            // The intended start counts, so that a late first iteration does not prolong the run.
            self.measuring_since.get_or_insert(intended);
        }
        Position { number: self.started, episode, step, warm_up }
    }

    /// Returns whether the next iteration is the first of its episode.
    pub(crate) const fn begins_episode(&self) -> bool {
        self.next.1 == 0
    }

    /// Returns whether the next iteration belongs to the warm-up at the start of the run, by the number of iterations
    /// or of episodes.
    pub(crate) fn is_next_run_warm_up(&self) -> bool {
        self.is_run_warm_up(self.next.0)
    }

    /// Returns whether no further iteration of an episode starts.
    pub(crate) const fn has_left(&self, episode: u32) -> bool {
        self.next.0 > episode
    }

    /// Ends an episode before its last step: the next iteration is the first one of the next episode.
    pub(crate) fn end_episode(&mut self, episode: u32) {
        // Iterations of the next episode may have started while the end of this one was on its way.
        if self.next.0 == episode {
            self.next = (episode.saturating_add(1), 0);
        }
    }

    /// Returns whether the next iteration, which belongs to `episode`, is within the warm-up at the start of the run.
    fn is_run_warm_up(&self, episode: u32) -> bool {
        let is_warm_up = self.started < self.warm_up.iterations
            || self.episode_steps.is_some() && episode < self.warm_up.episodes;
        // The warm-up of each episode still applies to a continuation.
        is_warm_up && !self.is_continuation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress(keys: &str, is_continuation: bool) -> Progress {
        let table = format!(
            "name = 'p'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
             placement = {{ kind = 'local', model = 'm' }}\n{keys}"
        );
        Progress::new(&toml::from_str(&table).expect("a pipeline"), is_continuation)
    }

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn limit_excludes_warm_up() {
        let mut progress = progress("warm_up = { iterations = 2 }\nlimit = { iterations = 3 }", false);
        let mut warm_up = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            warm_up.push(progress.assign_position(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false, false, false]);
    }

    #[test]
    fn total_includes_warm_up() {
        let mut progress =
            progress("warm_up = { iterations = 2 }\nlimit = { total = 3, iterations = 9 }", false);
        let mut warm_up = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            warm_up.push(progress.assign_position(at(0)).warm_up);
        }
        assert_eq!(warm_up, [true, true, false]);
    }

    #[test]
    fn planned_iterations_are_known_beforehand() {
        let planned_iterations = |keys: &str| {
            let mut progress = progress(keys, false);
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
        let mut progress = progress("warm_up = { iterations = 1 }\nlimit = { duration_s = 2.5 }", false);
        progress.assign_position(at(10));
        assert!(!progress.is_limit_reached(at(1000)), "still warming up");
        assert_eq!(
            progress.assign_position(at(20)),
            Position { number: 2, episode: 0, step: 1, warm_up: false }
        );
        assert!(!progress.is_limit_reached(at(22)));
        assert!(progress.is_limit_reached(at(23)));
    }

    #[test]
    fn episodes_and_their_first_steps_warm_up() {
        let keys = "episode_steps = 3\nwarm_up = { iterations = 0, episodes = 1, steps = 1 }";
        let mut progress = progress(keys, false);
        let positions: Vec<_> = (0..7).map(|_| progress.assign_position(at(0))).collect();
        let shape: Vec<_> =
            positions.iter().map(|position| (position.episode, position.step, position.warm_up)).collect();
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
        assert!(positions.iter().map(|position| position.number).eq(1..=7));
    }

    #[test]
    fn ended_episode_is_followed_by_next_one() {
        let mut progress = progress("episode_steps = 3\nlimit = { episodes = 3 }", false);
        let mut steps = Vec::new();
        while !progress.is_limit_reached(at(0)) {
            let begins = progress.begins_episode();
            let position = progress.assign_position(at(0));
            assert_eq!(begins, position.step == 0);
            steps.push((position.episode, position.step));
            // The first episode ends after its last step and the second one after its second step.
            if [(0, 2), (1, 1)].contains(&(position.episode, position.step)) {
                progress.end_episode(position.episode);
                assert!(progress.has_left(position.episode) && !progress.has_left(position.episode + 1));
            }
        }
        assert_eq!(steps, [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]);
    }

    #[test]
    fn without_steps_only_feedback_ends_episodes() {
        let mut progress = progress("", false);
        for number in 0..100 {
            assert_eq!((progress.assign_position(at(0)).step, progress.begins_episode()), (number, false));
        }
        progress.end_episode(0);
        let position = progress.assign_position(at(0));
        assert_eq!((position.episode, position.step), (1, 0));
    }

    #[test]
    fn continuing_run_has_no_warm_up() {
        assert!(!progress("", true).assign_position(at(0)).warm_up);
        assert!(progress("", false).assign_position(at(0)).warm_up);
    }
}
