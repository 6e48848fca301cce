//! End of a run and its report to the caller.

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_analysis::outcomes::{Counts, failed_in_warm_up};
use peernet_analysis::rows::{Outcome, Rows};
use peernet_statistics::number::{count, counted};
use peernet_stream::EndReason;

use super::unavailable;
use crate::foreground::AgentEnd;

impl AgentEnd {
    /// Returns the reason as written to `run.json`.
    pub(super) fn reason(&self) -> EndReason {
        match self {
            Self::Finished => EndReason::Finished,
            Self::Interrupted => EndReason::Stopped,
            Self::Failed(reason) => EndReason::Failed(reason.clone()),
            Self::OwnReason(never) => match *never {},
        }
    }

    /// Returns the failure of a run without any rows.
    pub(super) fn failure_without_rows(self) -> Failure {
        match self {
            Self::Finished => unavailable("nothing was measured: the sensor has no samples"),
            Self::Interrupted => {
                Failure::new(Exit::Interrupted, anyhow!("ended before the first measurement"))
            }
            Self::Failed(reason) => unavailable(&reason),
        }
    }

    /// Returns the failure of a run with results, if any. `unseen` is the number of iterations that were measured but
    /// have no row.
    pub(super) fn failure(&self, rows: &Rows, unseen: u64) -> Option<Failure> {
        let incomplete = |text: String| Some(Failure::new(Exit::Incomplete, anyhow!("{text}")));
        match self {
            Self::Interrupted => Some(Failure::new(
                Exit::Interrupted,
                anyhow!("ended early: the results contain the measurements until then"),
            )),
            Self::Failed(reason) => {
                incomplete(format!("{reason}; the results contain the measurements until then"))
            }
            Self::Finished if unseen > 0 => {
                let verb = if unseen == 1 { "was" } else { "were" };
                let iterations = counted(unseen, "iteration");
                incomplete(format!("{iterations} {verb} measured but not recorded: this machine is too busy"))
            }
            Self::Finished => incomplete(describe_failed_iterations(rows)?),
            Self::OwnReason(never) => match *never {},
        }
    }
}

/// Returns a clause about the failed iterations. An iteration has failed if it has no answer, or if its answer was
/// not acted on. Failed warm-up iterations, which statistics exclude, count only if no other iteration failed. `None`
/// if none failed.
fn describe_failed_iterations(rows: &Rows) -> Option<String> {
    // The number of iterations without a row is not needed here.
    let counts = Counts::from_rows(rows, 0);
    let in_warm_up = counts.all_failed() == 0;
    let failed = || rows.iter().filter(|row| row.warm_up() == in_warm_up && row.outcome() != Outcome::Ok);
    let first = failed().next()?;
    let are_actuator_failures =
        failed().all(|row| row.reason().is_some_and(|reason| reason.starts_with(ACTUATOR_FAILED)));
    let cause = if are_actuator_failures { " (the actuator failed to act on the answer)" } else { "" };
    let (failed_count, all, kind) = match in_warm_up {
        true => (failed_in_warm_up(rows), counts.warm_up, "warm-up iteration"),
        false => (counts.all_failed(), counts.measured(), "iteration"),
    };
    Some(format!(
        "{} of {} failed{cause}; {}",
        count(failed_count),
        counted(all, kind),
        describe_failure(first.iteration(), first.outcome(), first.reason())
    ))
}

/// Describes an iteration without an answer, or with one that was not acted on, with the reason: `iteration 3 was
/// lost: …`.
pub(super) fn describe_failure(iteration: u64, outcome: Outcome, reason: Option<&str>) -> String {
    let reason = reason.map_or("no answer in time", without_repetition);
    let verb = if outcome == Outcome::Lost { "was " } else { "" };
    format!("iteration {iteration} {verb}{}: {reason}", outcome.display_name())
}

/// Separator between an exception and its traceback.
const TRACEBACK: &str = " Traceback (most recent call last):";

/// Beginning of the reason if the actuator did not act on an answer.
const ACTUATOR_FAILED: &str = "the actuator failed: ";

/// Removes the repetition of the exception at the end of its traceback.
fn without_repetition(reason: &str) -> &str {
    let exception = reason.split_once(TRACEBACK).map_or("", |(exception, _)| exception.trim_end());
    // The agent puts the part of the pipeline that failed before the exception: `the sensor failed: …`.
    let raised = exception.split_once(" failed: ").map(|(_, raised)| raised);
    let shortened = [Some(exception), raised]
        .into_iter()
        .flatten()
        .find_map(|repetition| reason.strip_suffix(repetition));
    shortened.map_or(reason, str::trim_end)
}

#[cfg(test)]
mod tests {
    use peernet_analysis::rows::Row;

    use super::*;

    fn row(iteration: u64, outcome: Outcome) -> Row {
        Row {
            iteration,
            at: 0.0,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome,
            reason: (outcome == Outcome::Lost).then(|| "it went away".to_owned()),
            values: Vec::new(),
            upload: None,
            download: None,
        }
    }

    #[test]
    fn exception_is_reported_once() {
        let all = "E: dark Traceback (most recent call last):   File x, line 7     raise E E: dark";
        assert_eq!(
            without_repetition(all),
            "E: dark Traceback (most recent call last):   File x, line 7     raise E"
        );
        let others = ["it went away", "", "E: a Traceback (most recent call last):  …"];
        assert_eq!(others.map(without_repetition), others);
    }

    #[test]
    fn run_end_determines_exit_code_and_message() {
        let answered = Rows::from_iter([row(1, Outcome::Ok)]);
        assert!(AgentEnd::Finished.failure(&answered, 0).is_none());
        let code = |end: AgentEnd| end.failure(&answered, 0).map(|failure| failure.exit);
        assert_eq!(code(AgentEnd::Interrupted), Some(Exit::Interrupted));
        assert_eq!(code(AgentEnd::Failed("x".into())), Some(Exit::Incomplete));

        let warm_up = |iteration, outcome| Row { warm_up: true, ..row(iteration, outcome) };
        let rows = [
            warm_up(0, Outcome::Timeout),
            row(1, Outcome::Ok),
            row(2, Outcome::Lost),
            row(3, Outcome::Timeout),
        ];
        let partly_answered = Rows::from_iter(rows);
        let failure = AgentEnd::Finished.failure(&partly_answered, 0).expect("two failed");
        let text = "2 of 3 iterations failed; iteration 2 was lost: it went away";
        assert_eq!((failure.exit, failure.to_string().as_str()), (Exit::Incomplete, text));

        let lost = Rows::from_iter([row(1, Outcome::Lost)]);
        let failure = AgentEnd::Finished.failure(&lost, 0).expect("the iteration has no answer").to_string();
        assert!(failure.starts_with("1 of 1 iteration failed; iteration 1 was lost"), "{failure}");

        let first_is_late = [warm_up(1, Outcome::Timeout), warm_up(2, Outcome::Ok), row(3, Outcome::Ok)];
        let failure = AgentEnd::Finished.failure(&Rows::from_iter(first_is_late), 0).expect("one failed");
        let text = "1 of 2 warm-up iterations failed; iteration 1 timed out: no answer in time";
        assert_eq!((failure.exit, failure.to_string().as_str()), (Exit::Incomplete, text));

        let unseen = AgentEnd::Finished.failure(&answered, 3_000).expect("some are missing");
        assert!(
            unseen.exit == Exit::Incomplete
                && unseen.to_string().starts_with("3,000 iterations were measured but not recorded"),
            "{unseen}"
        );

        assert_eq!(AgentEnd::Failed("x".into()).failure_without_rows().exit, Exit::Unavailable);
        assert_eq!(AgentEnd::Interrupted.failure_without_rows().exit, Exit::Interrupted);
    }
}
