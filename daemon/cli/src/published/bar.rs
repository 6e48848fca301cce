//! Display of a client's progress.

use peernet_clock::SharedClock;
use peernet_stream::{Condition, Grade};

use crate::foreground::{Progress, remark};
use crate::measure::{Phase, Seen, Watcher};

/// A bar, or lines without a terminal.
pub(crate) struct Bar {
    clock: SharedClock,
    progress: Progress,
}

impl Bar {
    pub(crate) fn new(quiet: bool, clock: SharedClock) -> Self {
        Self { progress: Progress::new(quiet, clock.mono()), clock }
    }
}

impl Watcher for Bar {
    /// Prints conditions that impair the figures while the run can still be restarted; the rest is in the report.
    fn begun(&mut self, conditions: &[Condition]) {
        for condition in conditions.iter().filter(|condition| condition.grade >= Grade::Doubtful) {
            self.progress.say(remark(condition));
        }
    }

    fn look(&mut self, seen: &Seen) {
        if seen.phase == Phase::Writing {
            self.progress.end();
            return;
        }
        let share = seen.of.map_or(0.0, |of| seen.done as f64 / of.max(1) as f64);
        let state = || (seen.to_string(), share);
        self.progress.show(self.clock.mono(), seen.trouble.clone(), state);
    }
}
