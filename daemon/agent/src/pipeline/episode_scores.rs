//! Success and return of the episodes of a run, from the feedback of the actuator. No I/O.

use peernet_actuators::Feedback;
use peernet_analysis::actuator_results::{EPISODE_RETURN, EPISODE_SUCCESS};
use peernet_clock::Span;
use peernet_logger::{Measure, Name, NodeId, Slug, Tree, Unit};

/// Feedback on the episodes whose iterations are not all complete.
#[derive(Debug, Default)]
pub(super) struct EpisodeScores {
    open: Vec<OpenEpisode>,
    /// `true` once the actuator has reported a success or a failure of an episode in this run. From then on, an episode
    /// without such a report is no success.
    reports_success: bool,
    /// `true` once the actuator has reported a reward in this run.
    reports_reward: bool,
}

#[derive(Debug)]
struct OpenEpisode {
    number: u32,
    /// `false` for an episode of the warm-up at the start of the run.
    is_after_warm_up: bool,
    /// `false` for an episode whose preparation failed. No action was possible in it.
    is_prepared: bool,
    /// Latest report of success.
    success: Option<bool>,
    /// Sum of the rewards.
    total_reward: f64,
}

/// Result of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EpisodeResult {
    /// Whether the episode was a success; `None` if the actuator reports none.
    pub(super) success: Option<bool>,
    /// Return of the episode: the sum of its rewards, without a discount (Sutton and Barto, *Reinforcement Learning*,
    /// 2nd edition, section 3.3). Infinite or NaN if the finite rewards have no finite sum. `None` if the actuator
    /// reports no rewards, or the preparation of the episode failed.
    pub(super) total_reward: Option<f64>,
}

impl EpisodeScores {
    /// Begins an episode; `is_after_warm_up` is `false` for an episode of the warm-up.
    pub(super) fn begin(&mut self, number: u32, is_after_warm_up: bool) {
        let is_prepared = true;
        self.open.push(OpenEpisode::new(number, is_after_warm_up, is_prepared));
    }

    /// Begins an episode whose preparation failed. The episode is no success, and it has no return: a return of 0 might
    /// be better than the return of every other episode.
    pub(super) fn begin_unprepared(&mut self, number: u32, is_after_warm_up: bool) {
        let is_prepared = false;
        self.open.push(OpenEpisode::new(number, is_after_warm_up, is_prepared));
    }

    /// Adds the feedback on one action of an episode.
    pub(super) fn add(&mut self, number: u32, feedback: &Feedback) {
        self.reports_success |= feedback.success.is_some();
        self.reports_reward |= feedback.reward.is_some();
        if let Some(episode) = self.open.iter_mut().find(|episode| episode.number == number) {
            episode.success = feedback.success.or(episode.success);
            episode.total_reward += feedback.reward.unwrap_or(0.0);
        }
    }

    /// Ends an episode and returns its result. `None` if the episode has already ended, if it belongs to the warm-up,
    /// or if the actuator reports neither success nor rewards.
    pub(super) fn close(&mut self, number: u32) -> Option<EpisodeResult> {
        let index = self.open.iter().position(|episode| episode.number == number)?;
        let OpenEpisode { is_after_warm_up, is_prepared, success, total_reward, .. } =
            self.open.remove(index);
        let success = self.reports_success.then(|| success.unwrap_or(false));
        let total_reward = (self.reports_reward && is_prepared).then_some(total_reward);
        (is_after_warm_up && (success.is_some() || total_reward.is_some()))
            .then_some(EpisodeResult { success, total_reward })
    }
}

impl OpenEpisode {
    const fn new(number: u32, is_after_warm_up: bool, is_prepared: bool) -> Self {
        Self { number, is_after_warm_up, is_prepared, success: None, total_reward: 0.0 }
    }
}

impl EpisodeResult {
    /// Returns a remark if the rewards of episode `number` have no finite sum.
    pub(super) fn remark(&self, pipeline: &Slug, number: u32) -> Option<String> {
        let sum = self.total_reward.filter(|total| !total.is_finite())?;
        Some(format!(
            "pipeline {pipeline}: the rewards of episode {number} add up to {sum}, so the episode has no episode-return; make the actuator \
             report smaller rewards"
        ))
    }

    /// Adds the result to the tree of the episode's last iteration, at the time `end` after the start of that
    /// iteration.
    pub(super) fn record(&self, tree: &mut Tree, end: Span) {
        let mut add = |name: &'static str, value| {
            tree.add(NodeId::ROOT, Name::from_static(name), end, Measure::Value(value, Unit::NONE));
        };
        if let Some(success) = self.success {
            add(EPISODE_SUCCESS, if success { 1.0 } else { 0.0 });
        }
        // The statistics accept finite numbers only.
        if let Some(total_reward) = self.total_reward.filter(|total| total.is_finite()) {
            add(EPISODE_RETURN, total_reward);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AFTER_WARM_UP: bool = true;
    const DURING_WARM_UP: bool = false;

    fn reward(reward: f64) -> Feedback {
        Feedback { reward: Some(reward), ..Feedback::default() }
    }

    fn success(success: bool) -> Feedback {
        Feedback { success: Some(success), ..Feedback::default() }
    }

    #[test]
    fn return_is_sum_and_success_is_latest_report() {
        let mut scores = EpisodeScores::default();
        scores.begin(0, AFTER_WARM_UP);
        for feedback in [reward(0.5), success(false), Feedback::default(), reward(-2.0), success(true)] {
            scores.add(0, &feedback);
        }
        let result = Some(EpisodeResult { success: Some(true), total_reward: Some(-1.5) });
        assert_eq!(scores.close(0), result);
        assert_eq!(scores.close(0), None, "the episode has already ended");
        // The feedback comes after the end of its episode, so it counts for no episode.
        scores.add(0, &reward(7.0));
        scores.begin(1, AFTER_WARM_UP);
        let result_without_reports = Some(EpisodeResult { success: Some(false), total_reward: Some(0.0) });
        assert_eq!(scores.close(1), result_without_reports);
        scores.begin(2, AFTER_WARM_UP);
        [1e308, 1e308].iter().for_each(|value| scores.add(2, &reward(*value)));
        let pipeline = "line".parse().expect("a name");
        scores.begin_unprepared(3, AFTER_WARM_UP);
        assert_eq!(scores.close(3), Some(EpisodeResult { success: Some(false), total_reward: None }));
        let infinite_result = scores.close(2).expect("the episode has a result");
        let remark = infinite_result.remark(&pipeline, 2).expect("the sum is infinite");
        assert!(remark.contains("episode 2 add up to inf"), "{remark}");
        assert_eq!(result_without_reports.and_then(|result| result.remark(&pipeline, 1)), None);
    }

    #[test]
    fn episodes_of_warm_up_or_without_any_report_have_no_result() {
        let mut scores = EpisodeScores::default();
        scores.begin(0, AFTER_WARM_UP);
        assert_eq!(scores.close(0), None, "the actuator reports nothing");
        scores.begin(1, DURING_WARM_UP);
        scores.add(1, &success(true));
        assert_eq!(scores.close(1), None, "the episode belongs to the warm-up");
        scores.begin(2, AFTER_WARM_UP);
        scores.begin(3, AFTER_WARM_UP);
        scores.add(3, &success(true));
        assert_eq!(scores.close(2), Some(EpisodeResult { success: Some(false), total_reward: None }));
        assert_eq!(scores.close(3), Some(EpisodeResult { success: Some(true), total_reward: None }));
    }
}
