//! The life of a pipeline: set up, connect, run, end.
//!
//! After a reconnect the run continues if the peer, the model and the device are the same as before.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use peernet_inference::LoadError;
use peernet_logger::{HostId, RunId};
use peernet_networks::Address;
use peernet_stream::{
    Condition, EndReason, FaultyHost, IncidentKind, PipelineState, Placement as PlacementDescription,
};
use tokio_util::sync::CancellationToken;

use super::context::PipelineContext;
use super::drive::drive;
use super::observe::{self, SourceError};
use super::peer_problem::PeerProblem;
use super::pipeline_loop::{LoopEnd, LoopError};
use super::placement::{OpenFailure, Placement};
use super::resources::{AssembleError, PipelineResources};
use super::run::{Run, end_orphaned_run};
use crate::config::{PipelineConfig, PlacementConfig};
use crate::incidents::{IncidentSubject, remark};
use crate::live::PipelineLiveState;
use crate::reconnect_backoff::ReconnectBackoff;

/// Runs one pipeline until it finishes, fails, or the agent stops. A failure or panic ends this pipeline only.
pub(crate) async fn run(
    config: Arc<PipelineConfig>,
    live_state: Arc<PipelineLiveState>,
    context: PipelineContext,
    stop: CancellationToken,
    drain_timeout: Duration,
) {
    let runner = Runner { config, live_state, context, stop, drain_timeout };
    let outcome = AssertUnwindSafe(runner.run_to_end()).catch_unwind().await;
    match outcome.unwrap_or_else(|panic| Err(runner.handle_panic(panic.as_ref()))) {
        Ok(()) => runner.live_state.set_state(PipelineState::Finished),
        Err(error) => {
            let reason = error.to_string();
            runner.report(IncidentKind::PipelineFailed, None, reason.clone());
            runner.live_state.set_state(PipelineState::Failed(reason));
        }
    }
}

/// Reason why a pipeline could not start or had to stop.
#[derive(Debug, thiserror::Error)]
pub(super) enum PipelineError {
    #[error(transparent)]
    Assemble(#[from] AssembleError),
    /// The model of this host cannot be loaded.
    #[error(transparent)]
    Model(#[from] LoadError),
    #[error("loading the model panicked")]
    ModelPanicked,
    #[error(transparent)]
    Loop(#[from] LoopError),
    /// The topics of an observed system cannot be subscribed to.
    #[error(transparent)]
    Observe(#[from] SourceError),
    #[error("the pipeline panicked: {message}; see the log for the location in the code")]
    Panicked { message: String },
}

/// A pipeline and the parts of the agent that it reports to.
pub(super) struct Runner {
    pub(super) config: Arc<PipelineConfig>,
    pub(super) live_state: Arc<PipelineLiveState>,
    pub(super) context: PipelineContext,
    pub(super) stop: CancellationToken,
    /// Longest time for completing the iterations in flight when the agent stops.
    pub(super) drain_timeout: Duration,
}

impl Runner {
    /// Sets the pipeline up and runs it to its end.
    async fn run_to_end(&self) -> Result<(), PipelineError> {
        if let PlacementConfig::Observe(observed) = &self.config.placement {
            return observe::run_to_end(self, observed).await;
        }
        let Some(resources) = self.stop.run_until_cancelled(self.assemble()).await else { return Ok(()) };
        let mut resources = resources?;
        let result = self.run_assembled(&mut resources).await;
        resources.close().await;
        result
    }

    /// Runs the pipeline with these resources to its end.
    async fn run_assembled(&self, resources: &mut PipelineResources) -> Result<(), PipelineError> {
        let mut run: Option<Run> = None;
        let mut reconnect_backoff = ReconnectBackoff::new(self.context.host.id);
        let mut pause = Duration::ZERO;
        loop {
            let run_id = run.as_ref().map(Run::id);
            let connected = self.connect(resources, run_id, pause, &mut reconnect_backoff).await;
            let Some(placement) = connected? else {
                self.end_run(run.as_mut(), EndReason::Stopped);
                return Ok(());
            };
            // A peer that returns with another model or device is another configuration. Statistics of two
            // configurations must not be mixed, so a new run starts.
            if let Some(mut outdated_run) = run.take_if(|run| !run.has_placement(&placement.describe())) {
                self.end_run(
                    Some(&mut outdated_run),
                    EndReason::Failed("the peer, its model or its device changed".to_owned()),
                );
            }
            let current_run = match &mut run {
                Some(run) => run,
                None => {
                    let is_continuation = false;
                    let facts = resources.facts(placement.facts());
                    let new_run = self.start(facts, &placement, is_continuation).await;
                    resources.restart_schedule(self.context.host.clock.mono());
                    run.insert(new_run)
                }
            };
            let connected_at = self.context.host.clock.mono();
            let loop_end = self.measure(resources, current_run, &placement).await;
            let planned_iterations = current_run.planned_iterations(&loop_end);
            // The connection may be lost while the last iterations are in flight. No iteration would follow a reconnect.
            let is_complete = current_run.is_limit_reached(self.context.host.clock.mono());
            let (reason, result) = match loop_end {
                LoopEnd::Disconnected(reason) if !is_complete => {
                    self.report_disconnected(&placement, current_run.id(), reason);
                    let used_for = self.context.host.clock.mono() - connected_at;
                    pause = reconnect_backoff.pause_after_connection(used_for);
                    continue;
                }
                LoopEnd::Limit | LoopEnd::NoMoreSamples | LoopEnd::Midnight | LoopEnd::Disconnected(_) => {
                    (EndReason::Finished, Ok(()))
                }
                LoopEnd::Stopped => (EndReason::Stopped, Ok(())),
                LoopEnd::Broken(error) => (EndReason::Failed(error.to_string()), Err(error.into())),
            };
            self.end_run(run.as_mut(), reason);
            // An iteration records how many starts of iterations were skipped before it. No iteration follows the last
            // skipped starts, so they are logged.
            if resources.schedule.unreported_skips() > 0 {
                let (pipeline, skipped) = (&self.config.name, resources.schedule.unreported_skips());
                tracing::warn!(
                    %pipeline, skipped,
                    "the last iterations that were due before the run ended were skipped"
                );
            }
            placement.close(planned_iterations).await;
            return result;
        }
    }

    /// Sets up sensor, transforms and actuator on a blocking thread.
    async fn assemble(&self) -> Result<PipelineResources, AssembleError> {
        let (config, live_state) = (Arc::clone(&self.config), Arc::clone(&self.live_state));
        let (clock, fingerprint_key) =
            (Arc::clone(&self.context.host.clock), self.context.fingerprint_key.clone());
        self.live_state.set_sensor_busy_since(Some(clock.mono()));
        let assembling = move || PipelineResources::assemble(config, live_state, clock, &fingerprint_key);
        let assembled = tokio::task::spawn_blocking(assembling).await;
        self.live_state.set_sensor_busy_since(None);
        assembled.unwrap_or_else(|panic| Err(panic.into()))
    }

    /// Runs iterations at one placement until its connection is lost or the pipeline ends. At midnight a new run
    /// starts.
    async fn measure(
        &self,
        resources: &mut PipelineResources,
        run: &mut Run,
        placement: &Placement,
    ) -> LoopEnd {
        self.live_state.set_state(PipelineState::Running);
        loop {
            let loop_end =
                drive(resources, run, placement, &self.context, &self.stop, self.drain_timeout).await;
            if !matches!(loop_end, LoopEnd::Midnight) {
                return loop_end;
            }
            run.end(EndReason::Finished, &self.context);
            let is_continuation = true;
            *run = self.start(resources.facts(placement.facts()), placement, is_continuation).await;
        }
    }

    /// Ends the run after a panic of the pipeline's task, and returns the error. Other pipelines are not affected.
    fn handle_panic(&self, panic: &(dyn Any + Send)) -> PipelineError {
        let message = panic.downcast_ref::<String>().map(String::as_str);
        let message =
            message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message");
        let error = PipelineError::Panicked { message: message.to_owned() };
        end_orphaned_run(&self.config.name, EndReason::Failed(error.to_string()), &self.context);
        error
    }

    /// Inspects the conditions of both hosts, and starts a run at this placement.
    async fn start(&self, facts: Vec<(String, String)>, placement: &Placement, is_continuation: bool) -> Run {
        let conditions = placement.conditions(&self.context, is_continuation).await;
        self.start_run(facts, placement.describe(), conditions, is_continuation)
    }

    /// Starts a run and reports its start. `is_continuation` is `true` if the run directly continues another run.
    pub(super) fn start_run(
        &self,
        mut facts: Vec<(String, String)>,
        placement: PlacementDescription,
        conditions: Vec<Condition>,
        is_continuation: bool,
    ) -> Run {
        if let Some(faults) = self.context.host.clock.injected_faults() {
            facts.push((FaultyHost::Edge.fact_name(), faults.to_string()));
        }
        Run::start(
            &self.config,
            placement,
            (facts, conditions),
            is_continuation,
            &self.context,
            &self.live_state,
        )
    }

    fn end_run(&self, run: Option<&mut Run>, reason: EndReason) {
        if let Some(run) = run {
            run.end(reason, &self.context);
        }
    }

    /// Opens the placement after a pause, and retries until that succeeds. Returns `None` if the agent stops.
    async fn connect(
        &self,
        resources: &mut PipelineResources,
        run: Option<RunId>,
        mut pause: Duration,
        reconnect_backoff: &mut ReconnectBackoff,
    ) -> Result<Option<Placement>, PipelineError> {
        // If a run is in progress, the loss of its peer has already been reported.
        let mut reported_problem = run.map(|_| PeerProblem::Unreachable(String::new()));
        loop {
            let opening = async {
                tokio::time::sleep(pause).await;
                Placement::open(&self.config, &self.context).await
            };
            let Some(opening_result) = self.stop.run_until_cancelled(opening).await else { return Ok(None) };
            resources.skip_missed_starts(self.context.host.clock.mono());
            let problem = match opening_result {
                Ok(placement) => {
                    let ends_reported_problem = run.is_none() && reported_problem.is_some();
                    self.report_connected(&placement, run, ends_reported_problem);
                    return Ok(Some(placement));
                }
                // A retry cannot help: only a change of the configuration can.
                Err(OpenFailure::Model(error)) => return Err(error.into()),
                Err(OpenFailure::Panicked) => return Err(PipelineError::ModelPanicked),
                Err(OpenFailure::ModelServerUnreachable(error)) => {
                    PeerProblem::Unreachable(error.to_string())
                }
                Err(OpenFailure::Unreachable(error)) => PeerProblem::Unreachable(error.to_string()),
                Err(OpenFailure::Refused(error)) => PeerProblem::Refused(error.to_string()),
            };
            self.live_state.set_state(PipelineState::Waiting(problem.text().to_owned()));
            pause = problem.pause(reconnect_backoff);
            if !problem.is_covered_by(reported_problem.as_ref()) {
                let text = format!("{}; the pipeline continues automatically", problem.describe());
                self.report(problem.kind(), run, text);
                reported_problem = Some(problem);
            }
        }
    }

    /// Reports that the connection to a peer is open. A local model is reported only after its server could not be
    /// reached. `ends_reported_problem` is `true` if a failed attempt was reported before the run.
    fn report_connected(&self, placement: &Placement, run: Option<RunId>, ends_reported_problem: bool) {
        let description = placement.describe();
        if ends_reported_problem && placement.peer().is_none() {
            let text = format!("model {} is loaded, because its server answers now", description.model);
            let subject = IncidentSubject { pipeline: Some(&self.config.name), run, peer: None };
            self.context.events.incidents.report(IncidentKind::Connected, subject, text);
        }
        if let Some((peer, name)) = placement.peer() {
            let model = &description.model;
            let device = description.device.as_deref().unwrap_or("an unknown device");
            if let Some(caveat) = placement.caveat() {
                remark(&format!("connection to {name}: {caveat}"));
            }
            let caveat = placement.caveat().map(|caveat| format!("; {caveat}")).unwrap_or_default();
            let text = format!("connected to {name}, which runs {model} on {device}{caveat}");
            let subject = IncidentSubject { pipeline: Some(&self.config.name), run, peer: Some(peer) };
            self.context.events.incidents.report(IncidentKind::Connected, subject, text);
            self.follow_remarks(placement, peer);
        }
        self.live_state.set_placement(description);
    }

    /// Reports the transport's remarks about the connection as long as the connection is open.
    fn follow_remarks(&self, placement: &Placement, peer: HostId) {
        let Some(mut remarks) = placement.remarks() else { return };
        let (incidents, pipeline) = (self.context.events.incidents.clone(), self.config.name.clone());
        tokio::spawn(async move {
            let mut reported_remarks = 0;
            while remarks.changed().await.is_ok() {
                let all_remarks = remarks.borrow_and_update().clone();
                for text in all_remarks.get(reported_remarks..).unwrap_or_default() {
                    let subject = IncidentSubject { pipeline: Some(&pipeline), run: None, peer: Some(peer) };
                    incidents.remark(
                        IncidentKind::Connected,
                        subject,
                        format!("pipeline {pipeline}: {text}"),
                    );
                }
                reported_remarks = all_remarks.len();
            }
        });
    }

    fn report_disconnected(&self, placement: &Placement, run: RunId, reason: String) {
        let Some((peer, name)) = placement.peer() else { return };
        let address = self.peer_address().map(Address::to_string).unwrap_or_default();
        let text = format!(
            "lost the connection to {name} at {address}: {reason}; the run continues after a reconnect"
        );
        let subject = IncidentSubject { pipeline: Some(&self.config.name), run: Some(run), peer: Some(peer) };
        self.context.events.incidents.report(IncidentKind::Disconnected, subject, text);
        self.live_state.set_state(PipelineState::Waiting(reason));
    }

    fn peer_address(&self) -> Option<&Address> {
        match &self.config.placement {
            PlacementConfig::Local { .. } | PlacementConfig::None {} | PlacementConfig::Observe(_) => None,
            PlacementConfig::Remote(remote) => Some(&remote.peer),
        }
    }

    /// Reports an incident of the pipeline.
    pub(super) fn report(&self, kind: IncidentKind, run: Option<RunId>, text: String) {
        let subject = IncidentSubject { pipeline: Some(&self.config.name), run, peer: None };
        self.context.events.incidents.report(kind, subject, text);
    }
}

#[cfg(test)]
mod tests;
