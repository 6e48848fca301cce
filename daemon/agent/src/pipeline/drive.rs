//! The inner loop of a pipeline: from start to start until something ends it.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use futures::stream::{FuturesUnordered, StreamExt};
use tokio_util::sync::CancellationToken;

use super::context::PipelineContext;
use super::cycle::{Cycle, Ended, LoopError};
use super::line::Line;
use super::placement::Placement;
use super::run::Run;

/// Runs iterations of `run` at `placement` until one of the ends; all that had begun has been recorded by then.
///
/// After `stop` nothing begins any more, and what is under way has `patience` to finish.
pub(super) async fn drive(
    line: &mut Line,
    run: &mut Run,
    placement: &Placement,
    context: &PipelineContext,
    stop: &CancellationToken,
    patience: Duration,
) -> Ended {
    let timeout = line.config.timeout();
    let mut cycle = Cycle::new(line, run, context);
    let mut flights = FuturesUnordered::new();
    let mut stopping = pin!(stop.cancelled());
    let mut gone = pin!(placement.closed());
    let mut given_up = pin!(tokio::time::sleep(Duration::ZERO));
    let (mut is_stopping, mut is_gone) = (false, false);
    loop {
        if let Some(ready) = cycle.launch() {
            flights.push(ready.fly(placement, timeout, cycle.line.actuator.clone()));
        }
        if cycle.begin() {
            // A loop of parts that never wait would keep its thread from all other tasks.
            tokio::task::consume_budget().await;
            continue;
        }
        if let Some(ended) = cycle.ended() {
            return ended;
        }
        let alarm_at = cycle.wakes_at();
        let sensing = cycle.line.sensing.as_mut().map(|sensing| &mut sensing.sample);
        let alarm = &mut cycle.line.alarm;
        tokio::select! {
            biased;
            () = &mut stopping, if !is_stopping => {
                is_stopping = true;
                given_up.as_mut().reset(tokio::time::Instant::now() + patience);
                cycle.end(Ended::Stopped);
            }
            reason = &mut gone, if !is_gone => {
                is_gone = true;
                cycle.end(Ended::Disconnected(reason.to_string()));
            }
            Some(landed) = flights.next() => cycle.land(landed),
            Some(sensed) = maybe(sensing) => match sensed {
                Ok(sensed) => cycle.sensed(sensed),
                Err(_) => cycle.sensor_died(),
            },
            Some(rung) = maybe(alarm_at.map(|at| Box::pin(alarm.until(at)))) => {
                if let Err(error) = rung {
                    cycle.end(Ended::Broken(LoopError::Timer(Arc::new(error))));
                }
            }
            () = &mut given_up, if is_stopping => {
                cycle.abandon("the agent stopped before the answer came");
                return Ended::Stopped;
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
