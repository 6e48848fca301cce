//! Begin and end of episodes in the loop: the preparation before each iteration, and the end that the actuator reports.

use peernet_actuators::Feedback;
use peernet_stream::Outcome;

use super::PipelineLoop;
use crate::pipeline::in_flight::StartedIteration;
use crate::pipeline::iteration;
use crate::pipeline::load::Start;
use crate::pipeline::preparation::{Preparation, PreparationError};

impl PipelineLoop<'_> {
    /// Returns the preparation of the sensor and the actuator that must precede the next iteration, if there is one.
    pub(super) fn due_preparation(&self) -> Option<Preparation> {
        self.resources.due_preparation(self.run.begins_episode())
    }

    /// Ends the episode whose end the actuator has reported, unless a sample is outstanding. An outstanding sample
    /// still belongs to that episode.
    pub(super) fn end_reported_episode(&mut self) {
        if !self.has_outstanding_sample() {
            self.run.end_reported_episode();
        }
    }

    /// Handles the end of a preparation. If the preparation failed, a failed iteration with the reason is recorded, and
    /// its episode ends: no step of an episode may follow a failed reset, or use a simulation whose time is unknown.
    pub(in crate::pipeline) fn handle_preparation(&mut self, result: Result<(), PreparationError>) {
        self.resources.pending_preparation = None;
        let clock = &self.context.host.clock;
        let now = clock.mono();
        let outcome = match result {
            Ok(()) => Outcome::Ok,
            Err(PreparationError::SensorDied) => return self.handle_sensor_death(),
            Err(error) => Outcome::Failed(error.to_string()),
        };
        self.preparation_backoff.record_outcome(&outcome, now);
        self.resources.is_reset = outcome == Outcome::Ok;
        self.resources.resume_schedule(now);
        if outcome != Outcome::Ok && self.end_reason.is_none() {
            let start = Start { intended: now, skipped: 0 };
            let (log, started_at) = iteration::start(clock, self.context.host.id, now);
            let iteration =
                StartedIteration { position: self.run.assign_unprepared_position(now), start, started_at };
            let feedback = Feedback { episode_ended: true, ..Feedback::default() };
            self.finish(iteration, log, outcome, feedback, None);
        }
    }

    /// Returns whether an iteration of an episode is in flight or waits in the queue.
    pub(super) fn has_pending(&self, episode: u32) -> bool {
        let queued = self.queued.iter().map(|queued| &queued.iteration);
        self.in_flight.iter().chain(queued).any(|iteration| iteration.position.episode == episode)
    }
}
