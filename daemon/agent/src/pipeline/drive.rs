//! The inner loop of a pipeline: from start to start until something ends it.

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

/// Runs iterations of `run` at `placement` until one of the ends; all that had begun has been recorded by then.
///
/// After `stop` nothing begins any more, and what is under way has `patience` to finish.
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
            // A loop of parts that never wait would keep its thread from all other tasks.
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
            Some(sensed) = maybe(sensing) => match sensed {
                Ok(sensed) => pipeline_loop.sensed(sensed),
                Err(_) => pipeline_loop.sensor_died(),
            },
            Some(elapsed) = maybe(alarm_at.map(|at| Box::pin(start_timer.until(at)))) => {
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

/// What `future` yields, if there is one.
async fn maybe<F: Future>(future: Option<F>) -> Option<F::Output> {
    match future {
        Some(future) => Some(future.await),
        None => None,
    }
}
