//! Drives the inner loop of a pipeline: waits for the next event and passes it to the state machine.

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

/// Runs iterations of `run` at `placement` until the loop ends. By then every iteration that started is recorded.
///
/// After `stop` no iteration starts, and iterations in flight have `drain_timeout` to complete.
pub(super) async fn drive(
    resources: &mut PipelineResources,
    run: &mut Run,
    placement: &Placement,
    context: &PipelineContext,
    stop: &CancellationToken,
    drain_timeout: Duration,
) -> LoopEnd {
    let timeout = resources.config.timeout();
    let mut pipeline_loop = PipelineLoop::new(resources, run, context);
    // The iterations in flight are polled in this task and not spawned: an answer then wakes one task instead of two.
    let mut executing = FuturesUnordered::new();
    let mut stopping = pin!(stop.cancelled());
    let mut connection_closed = pin!(placement.closed());
    // The deadline is set when the agent stops; it is not polled before.
    let mut drain_deadline = pin!(tokio::time::sleep(Duration::ZERO));
    let (mut is_stopping, mut is_disconnected) = (false, false);
    loop {
        if let Some(queued_sample) = pipeline_loop.dequeue_sample() {
            executing.push(queued_sample.execute(
                placement,
                timeout,
                pipeline_loop.resources.actuator.clone(),
            ));
        }
        if pipeline_loop.perform_due_action() {
            // Without this call, a loop in which no part waits would never yield its thread to other tasks.
            tokio::task::consume_budget().await;
            continue;
        }
        if let Some(reason) = pipeline_loop.end_reason() {
            return reason;
        }
        let wakeup_at = pipeline_loop.next_wakeup();
        let sensing =
            pipeline_loop.resources.pending_sample.as_mut().map(|pending_sample| &mut pending_sample.sample);
        let preparing = pipeline_loop.resources.pending_preparation.as_mut();
        let start_timer = &mut pipeline_loop.resources.start_timer;
        tokio::select! {
            biased;
            // This branch is first in the biased choice, so that a stream of answers cannot delay the stop.
            () = &mut stopping, if !is_stopping => {
                is_stopping = true;
                drain_deadline.as_mut().reset(tokio::time::Instant::now() + drain_timeout);
                pipeline_loop.end(LoopEnd::Stopped);
            }
            reason = &mut connection_closed, if !is_disconnected => {
                is_disconnected = true;
                pipeline_loop.end(LoopEnd::Disconnected(reason.to_string()));
            }
            Some(completed) = executing.next() => pipeline_loop.complete(completed),
            Some(output) = await_if_some(sensing) => match output {
                Ok(output) => pipeline_loop.handle_sensor_output(output),
                Err(_) => pipeline_loop.handle_sensor_death(),
            },
            Some(result) = await_if_some(preparing) => pipeline_loop.handle_preparation(result),
            Some(elapsed) = await_if_some(wakeup_at.map(|at| Box::pin(start_timer.wait_until(at)))) => {
                if let Err(error) = elapsed {
                    pipeline_loop.end(LoopEnd::Broken(LoopError::Timer(Arc::new(error))));
                }
            }
            () = &mut drain_deadline, if is_stopping => {
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
