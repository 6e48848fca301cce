//! Runs that ended before their limit.

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::EndReason;
use serde::Deserialize;

/// Limits of a run: the table `limit` of its pipeline. A field that is `None` sets no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Limits {
    /// Number of iterations without the warm-up.
    pub iterations: Option<f64>,
    /// Number of iterations including the warm-up.
    pub total: Option<f64>,
    /// Number of episodes including the warm-up. The actuator may end an episode before its last step, so that the
    /// number of iterations is not known beforehand.
    pub episodes: Option<f64>,
    /// Duration from the first iteration that is not warm-up, seconds.
    pub duration_s: Option<f64>,
}

/// Part of a run that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of iterations without the warm-up, successful or failed. Iterations whose events were not received are
    /// included.
    pub measured: u64,
    /// Number of iterations in the warm-up.
    pub warm_up: u64,
    /// Number of episodes before that of the last iteration, including the warm-up; `None` if it is not known.
    pub episodes: Option<u64>,
    /// Time from the first to the last start after the warm-up, seconds; `None` if it is not known.
    pub seconds: Option<f64>,
}

/// Progress of a run that ended before its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct EndedEarly {
    /// Amount that was reached, in `unit`.
    pub reached: f64,
    /// Configured limit, in `unit`.
    pub limit: f64,
    /// Unit of both amounts.
    pub unit: LimitUnit,
    /// True if somebody interrupted the run; false if the run ended for another reason.
    pub interrupted: bool,
}

/// Unit of a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitUnit {
    /// Iterations, successful or failed.
    Iterations,
    /// Episodes, including the warm-up.
    Episodes,
    /// Seconds of measuring.
    Seconds,
}

impl EndedEarly {
    /// Compares the progress of a run that ended for `reason` with its limits. `None` if the run is complete, or if it
    /// had no limits.
    pub fn from_progress(limits: &Limits, progress: &Progress, reason: &EndReason) -> Option<Self> {
        let interrupted = *reason == EndReason::Stopped;
        let episodes = progress.episodes.map(|episodes| episodes as f64);
        let limits_and_reached = [
            (limits.episodes, episodes, LimitUnit::Episodes),
            (limits.iterations, Some(progress.measured as f64), LimitUnit::Iterations),
            (limits.total, Some(progress.measured as f64 + progress.warm_up as f64), LimitUnit::Iterations),
            (limits.duration_s, progress.seconds, LimitUnit::Seconds),
        ];
        let amounts = limits_and_reached.into_iter().filter_map(|(limit, reached, unit)| {
            let limit = limit.filter(|limit| *limit > 0.0)?;
            Some(Self { reached: reached?, limit, unit, interrupted })
        });
        // A run ends as soon as it reaches one of its limits. The relevant limit is therefore the limit that the run
        // came closest to.
        let nearest = amounts.max_by(|a, b| a.reached_share().total_cmp(&b.reached_share()))?;
        // With a limit of time, the last iteration starts shortly before the limit. With a limit of episodes, episodes
        // may end early. The reason for the end therefore decides whether such a run is complete.
        let is_iteration_count_variable = limits.duration_s.is_some() || limits.episodes.is_some();
        let is_complete =
            nearest.reached_share() >= 1.0 || (*reason == EndReason::Finished && is_iteration_count_variable);
        (!is_complete).then_some(nearest)
    }

    /// Returns the share of the limit that the run reached: 1 if the run reached the limit.
    pub fn reached_share(&self) -> f64 {
        self.reached / self.limit
    }

    /// Describes the end of a run that was interrupted or broke off: `was interrupted after 57 of 120 iterations`.
    /// `failure` is the reason why the run broke off. `None` for any other run.
    pub(crate) fn end_text(failure: Option<&str>, early: Option<&Self>) -> Option<String> {
        match (failure, early) {
            (Some(reason), Some(early)) => Some(format!("broke off {}: {reason}", early.progress_text())),
            (Some(reason), None) => Some(format!("broke off: {reason}")),
            (None, Some(early)) if early.interrupted => {
                Some(format!("was interrupted {}", early.progress_text()))
            }
            (None, _) => None,
        }
    }

    /// Describes the progress of the run: `after 57 of 120 iterations`.
    pub(crate) fn progress_text(&self) -> String {
        let Self { reached, limit, unit, .. } = self;
        let counted_text =
            |item: &str| format!("after {} of {}", fixed(*reached, 0), counted(*limit as u64, item));
        match unit {
            LimitUnit::Iterations => counted_text("iteration"),
            LimitUnit::Episodes => counted_text("episode"),
            LimitUnit::Seconds => format!("after {} of {}\u{202f}s", fixed(*reached, 1), significant(*limit)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finished_run_of_short_episodes_is_complete() {
        let limits = Limits { total: Some(900.0), episodes: Some(30.0), ..Limits::default() };
        let progress = Progress { measured: 400, warm_up: 50, episodes: Some(29), seconds: Some(9.0) };
        assert_eq!(EndedEarly::from_progress(&limits, &progress, &EndReason::Finished), None);
        assert!(EndedEarly::from_progress(&limits, &progress, &EndReason::Stopped).is_some());
        let only_episodes = Limits { total: None, ..limits };
        assert_eq!(EndedEarly::from_progress(&only_episodes, &progress, &EndReason::Finished), None);
        let without_episodes = Limits { episodes: None, ..limits };
        assert!(EndedEarly::from_progress(&without_episodes, &progress, &EndReason::Finished).is_some());
    }
}
