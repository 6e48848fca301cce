//! The live picture of the whole agent.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::MonoTime;
use peernet_logger::{RunId, Slug, Tree};
use peernet_stream::{Outcome, PipelineLive, PipelineState, Placement};

use super::ring::{Ring, Shown};

/// What a pipeline shows of itself. The pipeline's task writes; the lock is held for microseconds.
#[derive(Debug)]
pub(crate) struct Display {
    pipeline: Slug,
    load: String,
    face: Mutex<Face>,
}

#[derive(Debug)]
struct Face {
    state: PipelineState,
    run: Option<RunId>,
    placement: Placement,
    ring: Ring,
    senses_since: Option<MonoTime>,
}

impl Display {
    /// A pipeline that is starting.
    pub(crate) fn new(pipeline: Slug, load: String, placement: Placement) -> Self {
        let face = Face {
            state: PipelineState::Starting,
            run: None,
            placement,
            ring: Ring::default(),
            senses_since: None,
        };
        Self { pipeline, load, face: Mutex::new(face) }
    }

    /// What the pipeline does now.
    pub(crate) fn set_state(&self, state: PipelineState) {
        self.face().state = state;
    }

    /// Since when the sensor is set up, or asked for a sample on its thread; `None` when it is not.
    pub(crate) fn set_senses_since(&self, since: Option<MonoTime>) {
        self.face().senses_since = since;
    }

    /// The pipeline began a run.
    pub(crate) fn set_run(&self, run: RunId) {
        self.face().run = Some(run);
    }

    /// More is known of where it computes.
    pub(crate) fn set_placement(&self, placement: Placement) {
        self.face().placement = placement;
    }

    /// Adds an iteration that is not warm-up and ended within the second `at`.
    pub(crate) fn record(&self, at: i64, outcome: &Outcome, tree: &Tree) {
        self.face().ring.record(at, outcome, tree);
    }

    fn live(&self) -> (PipelineLive, Shown) {
        let face = self.face();
        let (seconds, shown) = face.ring.changed();
        let live = PipelineLive {
            pipeline: self.pipeline.clone(),
            state: face.state.clone(),
            run: face.run,
            placement: face.placement.clone(),
            load: self.load.clone(),
            seconds,
        };
        (live, shown)
    }

    fn face(&self) -> MutexGuard<'_, Face> {
        // A panic under the lock leaves numbers that are at worst incomplete.
        self.face.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// All pipelines of the agent.
#[derive(Clone, Debug)]
pub(crate) struct LiveStatistics(Arc<[Arc<Display>]>);

/// What was put into an update: to be handed back once the update is on its way.
#[derive(Debug)]
pub(crate) struct Receipt(Vec<Shown>);

impl LiveStatistics {
    pub(crate) fn new(displays: Vec<Arc<Display>>) -> Self {
        Self(displays.into())
    }

    /// Every pipeline with the seconds that changed since those of the last receipt.
    pub(crate) fn look(&self) -> (Vec<PipelineLive>, Receipt) {
        let (pipelines, shown) = self.0.iter().map(|display| display.live()).unzip();
        (pipelines, Receipt(shown))
    }

    /// Since when a pipeline waits for its sensor, if it does.
    pub(crate) fn senses_since(&self, pipeline: &Slug) -> Option<MonoTime> {
        self.0.iter().find(|display| display.pipeline == *pipeline)?.face().senses_since
    }

    /// The update of this receipt is on its way: what it held need not be shown again.
    pub(crate) fn delivered(&self, receipt: &Receipt) {
        for (display, shown) in self.0.iter().zip(&receipt.0) {
            display.face().ring.shown(shown);
        }
    }

    /// The receiver was restarted and knows nothing.
    pub(crate) fn start_over(&self) {
        for display in self.0.iter() {
            display.face().ring.forget_shown();
        }
    }
}
