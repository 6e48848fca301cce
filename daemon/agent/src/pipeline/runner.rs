//! The life of a pipeline: set up, connect, run, end.
//!
//! After a reconnect the same run continues if peer, model and device are the same.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use peernet_inference::LoadError;
use peernet_logger::{HostId, RunId};
use peernet_networks::Address;
use peernet_stream::{
    Condition, EndReason, FaultyHost, IncidentKind, PipelineState, Placement as Description,
};
use tokio_util::sync::CancellationToken;

use super::context::PipelineContext;
use super::drive::drive;
use super::observe::{self, SourceError};
use super::pipeline_loop::{LoopEnd, LoopError};
use super::placement::{OpenFailure, Placement};
use super::resources::{AssembleError, PipelineResources};
use super::run::{Run, end_orphan};
use crate::config::{PipelineConfig, PlacementConfig};
use crate::incidents::{IncidentContext, remark};
use crate::live::Display;
use crate::reconnect_backoff::ReconnectBackoff;

/// Runs one pipeline until it finishes, fails, or the agent stops. A failure or panic ends this pipeline only.
pub(crate) async fn run(
    config: Arc<PipelineConfig>,
    display: Arc<Display>,
    context: PipelineContext,
    stop: CancellationToken,
    patience: Duration,
) {
    let runner = Runner { config, display, context, stop, patience };
    let life = AssertUnwindSafe(runner.live()).catch_unwind().await;
    match life.unwrap_or_else(|panic| Err(runner.panicked(panic.as_ref()))) {
        Ok(()) => runner.display.set_state(PipelineState::Finished),
        Err(error) => {
            let reason = error.to_string();
            runner.report(IncidentKind::PipelineFailed, None, reason.clone());
            runner.display.set_state(PipelineState::Failed(reason));
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
    #[error("the pipeline panicked: {message}; the log says where")]
    Panicked { message: String },
}

/// A pipeline and the parts of the agent that it reports to.
pub(super) struct Runner {
    pub(super) config: Arc<PipelineConfig>,
    pub(super) display: Arc<Display>,
    pub(super) context: PipelineContext,
    pub(super) stop: CancellationToken,
    /// Time that iterations in flight may take when the agent stops.
    pub(super) patience: Duration,
}

/// Reason why a pipeline waits for its peer.
#[derive(Debug, PartialEq, Eq)]
enum ConnectTrouble {
    Away,
    Refused(String),
}

impl ConnectTrouble {
    const fn kind(&self) -> IncidentKind {
        match self {
            Self::Away => IncidentKind::Disconnected,
            Self::Refused(_) => IncidentKind::Refused,
        }
    }

    /// Returns the text about further attempts.
    fn outlook(&self) -> String {
        let (shortest, longest) =
            (ReconnectBackoff::SHORTEST.as_secs_f64(), ReconnectBackoff::LONGEST.as_secs());
        match self {
            Self::Away => {
                format!("trying again every {shortest} to {longest} s; the pipeline goes on by itself")
            }
            Self::Refused(_) => format!("trying again every {} s", ReconnectBackoff::REFUSED.as_secs()),
        }
    }
}

impl Runner {
    /// Sets the pipeline up and runs it to its end.
    async fn live(&self) -> Result<(), PipelineError> {
        if let PlacementConfig::Observe(observed) = &self.config.placement {
            return observe::live(self, observed).await;
        }
        let Some(resources) = self.stop.run_until_cancelled(self.assemble()).await else { return Ok(()) };
        let mut resources = resources?;
        let mut run: Option<Run> = None;
        loop {
            let Some(placement) = self.connect(&mut resources, run.as_ref().map(Run::id)).await? else {
                self.end(run.as_mut(), EndReason::Stopped);
                return Ok(());
            };
            // A peer that came back with another model or device is another configuration, whose statistics must not
            // be mixed with those before.
            if let Some(mut other) = run.take_if(|run| !run.is_at(&placement.describe())) {
                self.end(Some(&mut other), EndReason::Failed("the peer changed".to_owned()));
            }
            let current = match &mut run {
                Some(run) => run,
                None => {
                    let new_run = self.begin(resources.facts(placement.facts()), &placement, false).await;
                    resources.restart_schedule(self.context.host.clock.mono());
                    run.insert(new_run)
                }
            };
            let ended = self.measure(&mut resources, current, &placement).await;
            let planned_iterations = current.planned_iterations(&ended);
            let (reason, result) = match ended {
                LoopEnd::Disconnected(reason) => {
                    self.disconnected(&placement, current.id(), reason);
                    continue;
                }
                LoopEnd::Limit | LoopEnd::NoMoreSamples | LoopEnd::Midnight => (EndReason::Finished, Ok(())),
                LoopEnd::Stopped => (EndReason::Stopped, Ok(())),
                LoopEnd::Broken(error) => (EndReason::Failed(error.to_string()), Err(error.into())),
            };
            self.end(run.as_mut(), reason);
            // The next iteration reports the skipped starts before it. There is none after the last ones, so that the
            // log reports them.
            if resources.schedule.unreported_skips() > 0 {
                let (pipeline, starts) = (&self.config.name, resources.schedule.unreported_skips());
                tracing::warn!(%pipeline, starts, "the last starts before the end were skipped");
            }
            placement.close(planned_iterations).await;
            return result;
        }
    }

    /// Sets up sensor, transforms and actuator on a thread that may block.
    async fn assemble(&self) -> Result<PipelineResources, AssembleError> {
        let (config, display) = (Arc::clone(&self.config), Arc::clone(&self.display));
        let (clock, fingerprints) = (Arc::clone(&self.context.host.clock), self.context.fingerprints.clone());
        self.display.set_sensor_busy_since(Some(clock.mono()));
        let assembling = move || PipelineResources::assemble(config, display, clock, &fingerprints);
        let assembled = tokio::task::spawn_blocking(assembling).await;
        self.display.set_sensor_busy_since(None);
        assembled.unwrap_or_else(|panic| Err(panic.into()))
    }

    /// Measures at one placement until it is lost or the pipeline ends; at midnight a new run begins.
    async fn measure(
        &self,
        resources: &mut PipelineResources,
        run: &mut Run,
        placement: &Placement,
    ) -> LoopEnd {
        self.display.set_state(PipelineState::Running);
        loop {
            let ended = drive(resources, run, placement, &self.context, &self.stop, self.patience).await;
            if !matches!(ended, LoopEnd::Midnight) {
                return ended;
            }
            run.end(EndReason::Finished, &self.context);
            *run = self.begin(resources.facts(placement.facts()), placement, true).await;
        }
    }

    /// Ends the run after a panic of the pipeline's own task. Other pipelines are not affected.
    fn panicked(&self, panic: &(dyn Any + Send)) -> PipelineError {
        let message = panic.downcast_ref::<String>().map(String::as_str);
        let message =
            message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message");
        let error = PipelineError::Panicked { message: message.to_owned() };
        end_orphan(&self.config.name, EndReason::Failed(error.to_string()), &self.context);
        error
    }

    async fn begin(&self, facts: Vec<(String, String)>, placement: &Placement, warm: bool) -> Run {
        let conditions = placement.conditions(&self.context, warm).await;
        self.begin_run(facts, placement.describe(), conditions, warm)
    }

    /// Begins a run and reports its start; `warm` is `true` if it directly continues another.
    pub(super) fn begin_run(
        &self,
        mut facts: Vec<(String, String)>,
        placement: Description,
        conditions: Vec<Condition>,
        warm: bool,
    ) -> Run {
        if let Some(faults) = self.context.host.clock.faults() {
            facts.push((FaultyHost::Edge.fact(), faults.to_string()));
        }
        Run::begin(&self.config, placement, (facts, conditions), warm, &self.context, &self.display)
    }

    fn end(&self, run: Option<&mut Run>, reason: EndReason) {
        if let Some(run) = run {
            run.end(reason, &self.context);
        }
    }

    /// Opens the placement, with as many attempts as it takes. Returns `None` if the agent stops.
    async fn connect(
        &self,
        resources: &mut PipelineResources,
        run: Option<RunId>,
    ) -> Result<Option<Placement>, PipelineError> {
        let mut reconnect_backoff = ReconnectBackoff::new(self.context.host.id);
        // Each trouble is reported once and not at every attempt. In mid-run the loss of the peer has been reported
        // already.
        let mut reported = run.map(|_| ConnectTrouble::Away);
        loop {
            let opening = self.stop.run_until_cancelled(Placement::open(&self.config, &self.context));
            let Some(opened) = opening.await else { return Ok(None) };
            // The schedule continues meanwhile: starts that come due while there is no connection are skipped and
            // counted.
            resources.schedule.catch_up(self.context.host.clock.mono());
            let (trouble, error, pause) = match opened {
                Ok(placement) => {
                    self.connected(&placement, run);
                    return Ok(Some(placement));
                }
                // Another attempt cannot help while the configuration is the same.
                Err(OpenFailure::Model(error)) => return Err(error.into()),
                Err(OpenFailure::Panicked) => return Err(PipelineError::ModelPanicked),
                Err(OpenFailure::Away(error)) => {
                    (ConnectTrouble::Away, error.to_string(), reconnect_backoff.grow())
                }
                Err(OpenFailure::Refused(error)) => {
                    let error = error.to_string();
                    (ConnectTrouble::Refused(error.clone()), error, reconnect_backoff.refused())
                }
            };
            if reported.as_ref() != Some(&trouble) {
                self.report(trouble.kind(), run, format!("{error} ({})", trouble.outlook()));
                reported = Some(trouble);
            }
            self.display.set_state(PipelineState::Waiting(error));
            if self.stop.run_until_cancelled(tokio::time::sleep(pause)).await.is_none() {
                return Ok(None);
            }
        }
    }

    fn connected(&self, placement: &Placement, run: Option<RunId>) {
        let description = placement.describe();
        if let Some((peer, name)) = placement.peer() {
            let model = &description.model;
            let device = description.device.as_deref().unwrap_or("an unknown device");
            if let Some(caveat) = placement.caveat() {
                remark(&format!("the connection to {name}: {caveat}"));
            }
            let caveat = placement.caveat().map(|caveat| format!("; {caveat}")).unwrap_or_default();
            let text = format!("connected to {name}, which runs {model} on {device}{caveat}");
            let what = IncidentContext { pipeline: Some(&self.config.name), run, peer: Some(peer) };
            self.context.events.incidents.report(IncidentKind::Connected, what, text);
            self.follow_remarks(placement, peer);
        }
        self.display.set_placement(description);
    }

    /// Reports remarks of the transport about the connection while it is open.
    fn follow_remarks(&self, placement: &Placement, peer: HostId) {
        let Some(mut remarks) = placement.remarks() else { return };
        let (incidents, pipeline) = (self.context.events.incidents.clone(), self.config.name.clone());
        tokio::spawn(async move {
            let mut reported_remarks = 0;
            while remarks.changed().await.is_ok() {
                let all = remarks.borrow_and_update().clone();
                for text in all.get(reported_remarks..).unwrap_or_default() {
                    let what = IncidentContext { pipeline: Some(&pipeline), run: None, peer: Some(peer) };
                    incidents.remark(IncidentKind::Connected, what, format!("pipeline {pipeline}: {text}"));
                }
                reported_remarks = all.len();
            }
        });
    }

    fn disconnected(&self, placement: &Placement, run: RunId, reason: String) {
        let Some((peer, name)) = placement.peer() else { return };
        let address = self.peer_address().map(Address::to_string).unwrap_or_default();
        let text = format!("lost {name} at {address}: {reason}; the run goes on when it is back");
        let what = IncidentContext { pipeline: Some(&self.config.name), run: Some(run), peer: Some(peer) };
        self.context.events.incidents.report(IncidentKind::Disconnected, what, text);
        self.display.set_state(PipelineState::Waiting(reason));
    }

    fn peer_address(&self) -> Option<&Address> {
        match &self.config.placement {
            PlacementConfig::Local { .. } | PlacementConfig::None {} | PlacementConfig::Observe(_) => None,
            PlacementConfig::Remote(remote) => Some(&remote.peer),
        }
    }

    pub(super) fn report(&self, kind: IncidentKind, run: Option<RunId>, text: String) {
        let what = IncidentContext { pipeline: Some(&self.config.name), run, peer: None };
        self.context.events.incidents.report(kind, what, text);
    }
}

#[cfg(test)]
mod tests;
