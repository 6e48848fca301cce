//! Display of a client's progress.

use peernet_clock::SharedClock;
use peernet_stream::{Condition, Grade};

use crate::foreground::{Progress, describe_condition};
use crate::measure::{Phase, ProgressDisplay, ProgressReport};

/// Display of a client's progress: a bar on a terminal, otherwise lines.
pub(crate) struct ClientProgress {
    clock: SharedClock,
    progress: Progress,
    quiet: bool,
}

impl ClientProgress {
    pub(crate) fn new(quiet: bool, clock: SharedClock) -> Self {
        Self { progress: Progress::new(quiet, clock.mono()), quiet, clock }
    }
}

impl ProgressDisplay for ClientProgress {
    /// Prints the conditions that impair the measurements, so that the user can stop the run and improve them. Other
    /// conditions are only in the report.
    fn show_start(&mut self, conditions: &[Condition]) {
        for condition in conditions.iter().filter(|condition| condition.grade >= Grade::Doubtful) {
            self.progress.print_line(describe_condition(condition));
        }
    }

    fn show(&mut self, report: &ProgressReport) {
        if let Some(failure) = report.first_failure.as_ref().filter(|_| !self.quiet) {
            self.progress.print_once(failure);
        }
        if report.phase == Phase::Writing {
            self.progress.end();
            return;
        }
        let state = || (report.to_string(), report.fraction_done().unwrap_or(0.0));
        self.progress.show(self.clock.mono(), report.trouble.clone(), state);
    }
}
