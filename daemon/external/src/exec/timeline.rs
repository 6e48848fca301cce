//! Times of a model's stages between the request and the reply.

use peernet_clock::{MonoTime, Span};

use super::{ProgramCall, ProgramCallError};

/// Stages of a model. They count towards the sum of the stages. Only models may report them, and only as durations.
pub(super) const MODEL_STAGES: [&str; 3] = ["preprocessing", "inference", "postprocessing"];
/// Stage for the time that is not spent in the program: sending the request and receiving the reply.
const IPC: &str = "ipc";
/// Node that takes the place of `ipc` in the first reply after a restart; it includes the start of the program.
const RESTART: &str = "restart";
/// Largest time by which reported stages may be longer than the whole call. Such an excess is attributed to rounding.
const MAX_ROUNDING: Span = Span::from_millis(1);
/// Divisor of the call's duration. The quotient also limits the excess: the smaller of the two limits counts.
const ROUNDING_DIVISOR: i64 = 10;

/// Stage with its beginning and end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedStage {
    /// Name of the stage.
    pub name: String,
    /// Beginning of the stage.
    pub from: MonoTime,
    /// End of the stage.
    pub to: MonoTime,
}

impl ProgramCall {
    /// Returns the time from the request to the reply.
    pub fn duration(&self) -> Span {
        self.ended_at - self.started_at
    }

    /// Returns the interval from the restart of the program to its reply, if it was restarted. A program does not
    /// report when it is ready, so the duration of the start itself is unknown.
    pub fn restart_interval(&self) -> Option<(MonoTime, MonoTime)> {
        self.restart_began_at.map(|from| (from, self.ended_at))
    }

    /// Checks the stages of an actuator, all of which are parts of its action.
    ///
    /// # Errors
    /// [`ProgramCallError::StageTooLong`] if a stage is longer than the whole call.
    pub fn check_stages_of_action(&self) -> Result<(), ProgramCallError> {
        let limit = self.max_plausible_duration();
        match self.notes.stages.iter().find(|(_, span)| *span > limit) {
            Some((name, span)) => Err(ProgramCallError::StageTooLong {
                name: name.clone(),
                stage: span.to_duration(),
                call: self.duration().to_duration(),
            }),
            None => Ok(()),
        }
    }

    /// Returns the longest reported duration, of one stage or of all stages together, that rounding can explain.
    fn max_plausible_duration(&self) -> Span {
        let duration = self.duration();
        duration + Span::from_nanos(duration.nanos() / ROUNDING_DIVISOR).min(MAX_ROUNDING)
    }

    /// Returns the stages of a model.
    ///
    /// If the program reports none of `preprocessing`, `inference` and `postprocessing`, the whole time from request
    /// to reply is `inference`. Otherwise these stages have the reported durations and follow each other from the
    /// request on; the rest is `ipc`. Stages with other names begin with the request and are not part of the sum.
    ///
    /// After a restart only the reported stages count: they end with the reply, and the time before them is
    /// `restart`.
    ///
    /// # Errors
    /// [`ProgramCallError::StagesTooLong`] if the stages add up to more than the whole call.
    pub fn stages(&self) -> Result<Vec<TimedStage>, ProgramCallError> {
        let timed_stage = |name: &str, from, to| TimedStage { name: name.to_owned(), from, to };
        let is_summed = |name: &String| MODEL_STAGES.contains(&name.as_str());
        let summed = self.notes.stages.iter().filter(|(name, _)| is_summed(name));
        let reported_sum: Span = summed.map(|(_, span)| *span).sum();
        if reported_sum > self.max_plausible_duration() {
            let (stages, call) = (reported_sum.to_duration(), self.duration().to_duration());
            return Err(ProgramCallError::StagesTooLong { stages, call });
        }
        let stages_start = match self.restart_began_at {
            Some(from) => from + (self.ended_at - from - reported_sum).max(Span::ZERO),
            None => self.started_at,
        };
        let (mut stages, mut next_start) = (Vec::new(), stages_start);
        for (name, span) in &self.notes.stages {
            if is_summed(name) {
                stages.push(timed_stage(name, next_start, next_start + *span));
                next_start = next_start + *span;
            } else {
                stages.push(timed_stage(name, self.started_at, self.started_at + *span));
            }
        }
        // Statistics do not count a node with the name `restart` as a stage. Its time belongs to the preceding failure,
        // not to the loop, and would distort the sum of the stages.
        if let Some(from) = self.restart_began_at {
            stages.push(timed_stage(RESTART, from, stages_start));
        } else if !stages.iter().any(|stage| is_summed(&stage.name)) {
            stages.push(timed_stage("inference", self.started_at, self.ended_at));
        } else {
            stages.push(timed_stage(IPC, next_start.min(self.ended_at), self.ended_at));
        }
        Ok(stages)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exec::{ReplyNotes, ReplyOutcome};

    /// Returns the stages of a program that reported these durations (milliseconds) and replied after 10 ms.
    fn stages(reported: &[(&str, i64)]) -> Result<Vec<(String, i64, i64)>, ProgramCallError> {
        stages_after_restart(None, reported)
    }

    /// Returns the stages of a program whose restart began the given number of milliseconds before the request.
    fn stages_after_restart(
        restart_age: Option<i64>,
        reported: &[(&str, i64)],
    ) -> Result<Vec<(String, i64, i64)>, ProgramCallError> {
        let stages = reported.iter().map(|(name, ms)| ((*name).to_owned(), Span::from_millis(*ms))).collect();
        let (started_at, ended_at) = (MonoTime::from_nanos(0), MonoTime::from_nanos(10_000_000));
        let restart_began_at = restart_age.map(|age| MonoTime::from_nanos(-age * 1_000_000));
        let notes = ReplyNotes { stages, ..ReplyNotes::default() };
        let program_call =
            ProgramCall { restart_began_at, started_at, ended_at, notes, outcome: ReplyOutcome::Done };
        let millis = |at: MonoTime| at.nanos() / 1_000_000;
        Ok(program_call
            .stages()?
            .into_iter()
            .map(|stage| (stage.name, millis(stage.from), millis(stage.to)))
            .collect())
    }

    #[test]
    fn unreported_time_follows_stages_as_ipc() {
        let reported = stages(&[("preprocessing", 1), ("inference", 6), ("warm", 3)]).expect("adds up");
        let expected = [("preprocessing", 0, 1), ("inference", 1, 7), ("warm", 0, 3), ("ipc", 7, 10)];
        assert_eq!(reported, expected.map(|(name, from, to)| (name.to_owned(), from, to)));
    }

    #[test]
    fn whole_call_is_inference_without_reported_stages() {
        assert_eq!(stages(&[]).expect("adds up"), [("inference".to_owned(), 0, 10)]);
        assert_eq!(stages(&[("warm", 3)]).expect("adds up")[1], ("inference".to_owned(), 0, 10));
    }

    #[test]
    fn only_reported_stages_count_after_restart() {
        let reported =
            stages_after_restart(Some(2), &[("inference", 3), ("postprocessing", 1)]).expect("adds up");
        let expected = [("inference", 6, 9), ("postprocessing", 9, 10), ("restart", -2, 6)];
        assert_eq!(reported, expected.map(|(name, from, to)| (name.to_owned(), from, to)));
        assert_eq!(stages_after_restart(Some(2), &[]).expect("adds up"), [("restart".to_owned(), -2, 10)]);
        assert!(
            stages_after_restart(Some(90_000), &[("inference", 11_500)]).is_err(),
            "the call took 10 ms from request to reply"
        );
    }

    #[test]
    fn stages_beyond_rounding_tolerance_are_refused() {
        assert_eq!(stages(&[("inference", 11)]).expect("is rounded")[1], ("ipc".to_owned(), 10, 10));
        assert!(matches!(stages(&[("inference", 80_000)]), Err(ProgramCallError::StagesTooLong { .. })));
    }
}
