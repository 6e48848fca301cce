//! Result and timing of a call.

use peernet_clock::{MonoTime, Span};
use peernet_sample::Part;

use super::PythonError;

/// Result of a call, with its timing.
#[derive(Debug)]
pub struct CallResult {
    /// The returned value as parts; `None` if a sensor has no more samples.
    pub result: Result<Option<Vec<Part>>, PythonError>,
    /// Timing of the call.
    pub times: CallTimes,
}

/// Step of a call that runs in custom code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// `sample()` of a sensor.
    Sample,
    /// `preprocess(x)` of a model.
    Preprocess,
    /// `infer(x)` of a model.
    Infer,
    /// `postprocess(y)` of a model.
    Postprocess,
    /// `act(answer)` of an actuator.
    Act,
}

/// Timing of a call on PEERNet's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
pub struct CallTimes {
    /// Time at which this call began to start a new process, because the last process had ended. The new process was
    /// ready at `started_at`. `None` if no process was started.
    pub restart_began_at: Option<MonoTime>,
    /// Beginning of the call.
    pub started_at: MonoTime,
    /// Time at which the result was received.
    pub ended_at: MonoTime,
    /// Steps that were run, in order, with their beginning and end. If a step raised an exception, no step follows it.
    pub steps: Vec<(Step, MonoTime, MonoTime)>,
}

impl CallTimes {
    /// Converts the worker's stamps.
    ///
    /// The worker stamps with `time.monotonic_ns()`, which reads the same clock as PEERNet. Only if PEERNet has another
    /// clock, as in some tests, the stamps may lie outside of the call. The steps then follow each other from the
    /// beginning of the call.
    pub(super) fn new(started_at: MonoTime, ended_at: MonoTime, stamps: &[(Step, i64, i64)]) -> Self {
        // End of the last step; `None` if the stamps are not in order.
        let last_end = stamps.iter().try_fold(started_at.nanos(), |previous_end, (_, from, to)| {
            (previous_end <= *from && from <= to).then_some(*to)
        });
        let mut next_start = started_at;
        let timed_step = |&(step, from, to): &(Step, i64, i64)| match last_end {
            Some(last_end) if last_end <= ended_at.nanos() => {
                (step, MonoTime::from_nanos(from), MonoTime::from_nanos(to))
            }
            _ => {
                let step_start = next_start;
                next_start = next_start + Span::from_nanos(to.saturating_sub(from).max(0));
                (step, step_start, next_start)
            }
        };
        Self { restart_began_at: None, started_at, ended_at, steps: stamps.iter().map(timed_step).collect() }
    }

    /// Returns the time that is not spent in custom code: transfer and conversion of the arguments and of the result.
    pub fn overhead(&self) -> Span {
        let in_steps: Span = self.steps.iter().map(|(_, from, to)| *to - *from).sum();
        (self.ended_at - self.started_at - in_steps).max(Span::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(nanos: i64) -> MonoTime {
        MonoTime::from_nanos(nanos)
    }

    #[test]
    fn stamps_within_call_are_kept() {
        let stamps = [(Step::Preprocess, 120, 130), (Step::Infer, 131, 180)];
        let times = CallTimes::new(at(100), at(200), &stamps);
        assert_eq!(times.steps, [(Step::Preprocess, at(120), at(130)), (Step::Infer, at(131), at(180))]);
        assert_eq!(times.overhead(), Span::from_nanos(41));
    }

    #[test]
    fn steps_stamped_by_another_clock_keep_their_durations() {
        let stamps = [(Step::Preprocess, 9120, 9130), (Step::Infer, 9131, 9180)];
        let times = CallTimes::new(at(100), at(200), &stamps);
        assert_eq!(times.steps, [(Step::Preprocess, at(100), at(110)), (Step::Infer, at(110), at(159))]);
        assert_eq!(times.overhead(), Span::from_nanos(41));
        assert_eq!(CallTimes::new(at(0), at(5), &stamps).overhead(), Span::ZERO);
    }
}
