//! Live state of the pipelines, and of the whole agent.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::MonoTime;
use peernet_logger::{RunId, Slug, Tree};
use peernet_stream::{Outcome, PipelineLive, PipelineState, Placement};

use super::ring::{Ring, SecondVersions};

/// Live state of a pipeline. The pipeline's task updates the state; locks are held for microseconds.
#[derive(Debug)]
pub(crate) struct PipelineLiveState {
    pipeline: Slug,
    /// Configured load as text: `closed`, `5 Hz`.
    load: String,
    fields: Mutex<LiveFields>,
}

#[derive(Debug)]
struct LiveFields {
    state: PipelineState,
    run: Option<RunId>,
    placement: Placement,
    ring: Ring,
    sensor_busy_since: Option<MonoTime>,
}

impl PipelineLiveState {
    /// Creates the state of a pipeline that is starting.
    pub(crate) fn new(pipeline: Slug, load: String, placement: Placement) -> Self {
        let fields = LiveFields {
            state: PipelineState::Starting,
            run: None,
            placement,
            ring: Ring::default(),
            sensor_busy_since: None,
        };
        Self { pipeline, load, fields: Mutex::new(fields) }
    }

    /// Sets the state that is shown for the pipeline.
    pub(crate) fn set_state(&self, state: PipelineState) {
        self.lock().state = state;
    }

    /// Sets the time since which the pipeline waits for its sensor to be set up or to return a sample; `None` if it
    /// does not wait.
    pub(crate) fn set_sensor_busy_since(&self, since: Option<MonoTime>) {
        self.lock().sensor_busy_since = since;
    }

    /// Sets the run in progress.
    pub(crate) fn set_run(&self, run: RunId) {
        self.lock().run = Some(run);
    }

    /// Sets the placement.
    pub(crate) fn set_placement(&self, placement: Placement) {
        self.lock().placement = placement;
    }

    /// Adds an iteration that ended within the second `unix_second` (Unix time).
    pub(crate) fn record(&self, unix_second: i64, outcome: &Outcome, warm_up: bool, tree: &Tree) {
        self.lock().ring.record(unix_second, outcome, warm_up, tree);
    }

    fn live(&self) -> (PipelineLive, SecondVersions) {
        let fields = self.lock();
        let (seconds, versions) = fields.ring.changed_seconds();
        let live = PipelineLive {
            pipeline: self.pipeline.clone(),
            state: fields.state.clone(),
            run: fields.run,
            placement: fields.placement.clone(),
            load: self.load.clone(),
            seconds,
        };
        (live, versions)
    }

    fn lock(&self) -> MutexGuard<'_, LiveFields> {
        // A poisoned lock is used, too: a panic of the thread that held the lock leaves the statistics incomplete at
        // worst.
        self.fields.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Live statistics of all pipelines. Clones share the statistics.
#[derive(Clone, Debug)]
pub(crate) struct LiveStatistics(Arc<[Arc<PipelineLiveState>]>);

/// Seconds of each pipeline in an update; passed to [`LiveStatistics::mark_sent`] once the update is sent.
#[derive(Debug)]
pub(crate) struct Receipt(Vec<SecondVersions>);

impl Receipt {
    /// Keeps the newest `max_seconds` seconds of each pipeline: the other seconds were not sent.
    pub(crate) fn truncate(&mut self, max_seconds: usize) {
        self.0.iter_mut().for_each(|versions| versions.truncate(max_seconds));
    }
}

impl LiveStatistics {
    pub(crate) fn new(states: Vec<Arc<PipelineLiveState>>) -> Self {
        Self(states.into())
    }

    /// Returns every pipeline with the seconds that changed since they were last marked as sent, and a receipt for
    /// them.
    pub(crate) fn snapshot(&self) -> (Vec<PipelineLive>, Receipt) {
        let (pipelines, versions) = self.0.iter().map(|live_state| live_state.live()).unzip();
        (pipelines, Receipt(versions))
    }

    /// Returns the time since which a pipeline waits for its sensor; `None` if it does not wait.
    pub(crate) fn sensor_busy_since(&self, pipeline: &Slug) -> Option<MonoTime> {
        self.0.iter().find(|live_state| live_state.pipeline == *pipeline)?.lock().sensor_busy_since
    }

    /// Marks the seconds of a receipt as sent.
    pub(crate) fn mark_sent(&self, receipt: &Receipt) {
        for (live_state, versions) in self.0.iter().zip(&receipt.0) {
            live_state.lock().ring.mark_sent(versions);
        }
    }

    /// Marks all seconds as not sent, because the receiver was restarted and has no seconds.
    pub(crate) fn mark_all_unsent(&self) {
        for live_state in self.0.iter() {
            live_state.lock().ring.mark_all_unsent();
        }
    }
}
