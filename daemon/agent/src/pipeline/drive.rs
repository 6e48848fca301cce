//! Drives the inner loop of a pipeline: waits for whatever the state machine needs next.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use futures::stream::{FuturesUnordered, StreamExt};
use tokio_util::sync::CancellationToken;

use super::context::PipelineContext;
use super::pipeline_loop::{LoopEnd, LoopError, PipelineLoop};
use super::placement::Placement;
use super::resources::PipelineResources;
use super::run::Run;

/// Runs iterations of `run` at `placement` until the loop ends. All iterations that had begun are recorded by then.
///
/// After `stop` no iteration begins, and those in flight have `patience` to complete.
pub(super) async fn drive(
    resources: &mut PipelineResources,
    run: &mut Run,
    placement: &Placement,
    context: &PipelineContext,
    stop: &CancellationToken,
    patience: Duration,
) -> LoopEnd {
    let timeout = resources.config.timeout();
    let mut pipeline_loop = PipelineLoop::new(resources, run, context);
    // Polled in this task and not spawned, so that an answer wakes no second task.
    let mut executing = FuturesUnordered::new();
    let mut stopping = pin!(stop.cancelled());
    let mut gone = pin!(placement.closed());
    let mut given_up = pin!(tokio::time::sleep(Duration::ZERO));
    let (mut is_stopping, mut is_gone) = (false, false);
    loop {
        if let Some(ready) = pipeline_loop.launch() {
            executing.push(ready.execute(placement, timeout, pipeline_loop.resources.actuator.clone()));
        }
        if pipeline_loop.begin() {
            // If no part ever waits, the loop would never yield its thread to other tasks.
            tokio::task::consume_budget().await;
            continue;
        }
        if let Some(ended) = pipeline_loop.ended() {
            return ended;
        }
        let alarm_at = pipeline_loop.wakes_at();
        let sensing = pipeline_loop.resources.sensing.as_mut().map(|sensing| &mut sensing.sample);
        let start_timer = &mut pipeline_loop.resources.start_timer;
        tokio::select! {
            biased;
            // First in this biased choice, so that a stream of answers cannot delay the stop.
            () = &mut stopping, if !is_stopping => {
                is_stopping = true;
                given_up.as_mut().reset(tokio::time::Instant::now() + patience);
                pipeline_loop.end(LoopEnd::Stopped);
            }
            reason = &mut gone, if !is_gone => {
                is_gone = true;
                pipeline_loop.end(LoopEnd::Disconnected(reason.to_string()));
            }
            Some(completed) = executing.next() => pipeline_loop.complete(completed),
            Some(sensed) = await_if_some(sensing) => match sensed {
                Ok(sensed) => pipeline_loop.sensed(sensed),
                Err(_) => pipeline_loop.sensor_died(),
            },
            Some(elapsed) = await_if_some(alarm_at.map(|at| Box::pin(start_timer.until(at)))) => {
                if let Err(error) = elapsed {
                    pipeline_loop.end(LoopEnd::Broken(LoopError::Timer(Arc::new(error))));
                }
            }
            () = &mut given_up, if is_stopping => {
                pipeline_loop.abandon("the agent stopped before the answer came");
                return LoopEnd::Stopped;
            }
        }
    }
}

/// Waits for `future` and returns its result; `None` at once if there is no future.
async fn await_if_some<F: Future>(future: Option<F>) -> Option<F::Output> {
    match future {
        Some(future) => Some(future.await),
        None => None,
    }
}
