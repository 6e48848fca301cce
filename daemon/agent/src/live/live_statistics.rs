//! The live statistics of the whole agent.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::MonoTime;
use peernet_logger::{RunId, Slug, Tree};
use peernet_stream::{Outcome, PipelineLive, PipelineState, Placement};

use super::ring::{Ring, Shown};

/// Live state of a pipeline. The pipeline's task writes it; the lock is held for microseconds.
#[derive(Debug)]
pub(crate) struct Display {
    pipeline: Slug,
    load: String,
    display_state: Mutex<DisplayState>,
}

#[derive(Debug)]
struct DisplayState {
    state: PipelineState,
    run: Option<RunId>,
    placement: Placement,
    ring: Ring,
    sensor_busy_since: Option<MonoTime>,
}

impl Display {
    /// Creates the state of a pipeline that is starting.
    pub(crate) fn new(pipeline: Slug, load: String, placement: Placement) -> Self {
        let display_state = DisplayState {
            state: PipelineState::Starting,
            run: None,
            placement,
            ring: Ring::default(),
            sensor_busy_since: None,
        };
        Self { pipeline, load, display_state: Mutex::new(display_state) }
    }

    /// Sets the state that is shown for the pipeline.
    pub(crate) fn set_state(&self, state: PipelineState) {
        self.display_state().state = state;
    }

    /// Sets the time since which the sensor is being set up or its thread is asked for a sample; `None` if neither.
    pub(crate) fn set_sensor_busy_since(&self, since: Option<MonoTime>) {
        self.display_state().sensor_busy_since = since;
    }

    /// Sets the run in progress.
    pub(crate) fn set_run(&self, run: RunId) {
        self.display_state().run = Some(run);
    }

    /// Sets the placement, once more is known of it.
    pub(crate) fn set_placement(&self, placement: Placement) {
        self.display_state().placement = placement;
    }

    /// Adds an iteration that is not warm-up and ended within the second `at` (Unix time).
    pub(crate) fn record(&self, at: i64, outcome: &Outcome, tree: &Tree) {
        self.display_state().ring.record(at, outcome, tree);
    }

    fn live(&self) -> (PipelineLive, Shown) {
        let display_state = self.display_state();
        let (seconds, shown) = display_state.ring.changed();
        let live = PipelineLive {
            pipeline: self.pipeline.clone(),
            state: display_state.state.clone(),
            run: display_state.run,
            placement: display_state.placement.clone(),
            load: self.load.clone(),
            seconds,
        };
        (live, shown)
    }

    fn display_state(&self) -> MutexGuard<'_, DisplayState> {
        // After a panic under the lock the numbers are at worst incomplete.
        self.display_state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Live statistics of all pipelines; clones share them.
#[derive(Clone, Debug)]
pub(crate) struct LiveStatistics(Arc<[Arc<Display>]>);

/// Seconds that an update contains; passed to [`LiveStatistics::delivered`] once the update is sent.
#[derive(Debug)]
pub(crate) struct Receipt(Vec<Shown>);

impl LiveStatistics {
    pub(crate) fn new(displays: Vec<Arc<Display>>) -> Self {
        Self(displays.into())
    }

    /// Returns every pipeline with the seconds that changed since the last delivered receipt.
    pub(crate) fn snapshot(&self) -> (Vec<PipelineLive>, Receipt) {
        let (pipelines, shown) = self.0.iter().map(|display| display.live()).unzip();
        (pipelines, Receipt(shown))
    }

    /// Returns the time since which a pipeline waits for its sensor, if it does.
    pub(crate) fn sensor_busy_since(&self, pipeline: &Slug) -> Option<MonoTime> {
        self.0.iter().find(|display| display.pipeline == *pipeline)?.display_state().sensor_busy_since
    }

    /// Marks the seconds of a receipt as sent.
    pub(crate) fn delivered(&self, receipt: &Receipt) {
        for (display, shown) in self.0.iter().zip(&receipt.0) {
            display.display_state().ring.shown(shown);
        }
    }

    /// Marks all seconds as not sent, because the receiver was restarted and has none.
    pub(crate) fn start_over(&self) {
        for display in self.0.iter() {
            display.display_state().ring.forget_shown();
        }
    }
}
