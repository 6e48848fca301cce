//! Life cycle of the process: parts are started in order, watched, and stopped in reverse order.
//!
//! A signal (SIGTERM, SIGINT, or SIGHUP at the end of a session) stops the parts gracefully. A second signal ends the
//! process at once with exit code 70. A part that does not stop in time is aborted, and the exit code is 70, too. A
//! part that ends by itself is an error, because a daemon that has lost a task must not look healthy.

use std::io;
use std::time::Duration;

use anyhow::Context;
use futures::future::BoxFuture;
use sd_notify::NotifyState;
use serde::{Deserialize, Serialize};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;
use tracing::{debug, error, info, warn};

use peernet_cli::exit::{Exit, error_line};
use peernet_cli::shutdown_signals::Signals;

/// The table `[lifecycle]` of the configuration.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LifecycleConfig {
    /// Longest time for stopping; seconds, up to one day. After this time, the process ends without waiting further.
    /// Default: 10.
    pub(crate) shutdown_deadline_s: u64,
}

/// Error for a deadline that is longer than one day.
#[derive(Debug, thiserror::Error)]
#[error("{deadline_s} s is too long; the longest deadline is {} s, a day", LifecycleConfig::MAX_DEADLINE_S)]
pub(crate) struct DeadlineError {
    deadline_s: u64,
}

impl LifecycleConfig {
    /// Longest permitted deadline, seconds: one day.
    const MAX_DEADLINE_S: u64 = 86_400;

    /// Checks the deadline.
    ///
    /// # Errors
    /// If the deadline is longer than one day.
    pub(crate) fn check(&self) -> Result<(), DeadlineError> {
        match self.shutdown_deadline_s {
            ..=Self::MAX_DEADLINE_S => Ok(()),
            deadline_s => Err(DeadlineError { deadline_s }),
        }
    }
}

impl Default for LifecycleConfig {
    fn default() -> Self {
        Self { shutdown_deadline_s: 10 }
    }
}

/// Time that is reserved for each part that has not been stopped yet, unless the deadline is too short for it.
const RESERVED_PER_PART: Duration = Duration::from_secs(1);

/// A part of the process, which runs until it is stopped.
struct Part {
    name: &'static str,
    /// Token that stops the part when it is cancelled.
    stop: CancellationToken,
    /// Token that is cancelled when the task has ended for any reason.
    ended: CancellationToken,
    task: JoinHandle<anyhow::Result<()>>,
}

/// Owns the parts and the signal handlers, and notifies the service manager.
pub(crate) struct Lifecycle {
    parts: Vec<Part>,
    signals: Signals,
    stop_timeout: Duration,
}

impl Lifecycle {
    /// Installs the signal handlers.
    ///
    /// # Errors
    /// If the signal handlers cannot be installed.
    pub(crate) fn new(config: &LifecycleConfig) -> io::Result<Self> {
        Ok(Self {
            parts: Vec::new(),
            signals: Signals::new()?,
            stop_timeout: Duration::from_secs(config.shutdown_deadline_s),
        })
    }

    /// Starts a part. `start` gets the token that stops the part, and returns the future that completes when the part
    /// has ended. A signal that arrives during the start is not lost: [`run`](Self::run) receives it.
    ///
    /// # Errors
    /// If the part cannot start.
    pub(crate) async fn start<F>(&mut self, name: &'static str, start: F) -> anyhow::Result<()>
    where
        F: AsyncFnOnce(CancellationToken) -> anyhow::Result<BoxFuture<'static, anyhow::Result<()>>>,
    {
        let stop = CancellationToken::new();
        let part = start(stop.clone()).await.with_context(|| format!("cannot start the {name}"))?;
        let ended = CancellationToken::new();
        // The guard cancels the token when it is dropped, even if the task panics.
        let guard = ended.clone().drop_guard();
        let task = tokio::spawn(async move {
            let _guard = guard;
            part.await
        });
        self.parts.push(Part { name, stop, ended, task });
        debug!("the {name} has started");
        Ok(())
    }

    /// Reports READY, watches until a signal arrives or a part ends, stops all parts, and returns the exit code.
    pub(crate) async fn run(mut self) -> Exit {
        notify(&[NotifyState::Ready]);
        let mut exit = self.watch().await;
        notify(&[NotifyState::Stopping]);

        let Self { parts, mut signals, stop_timeout } = self;
        // A failure while stopping determines the exit code, even after a signal.
        tokio::select! {
            stop_exit = stop_in_reverse(parts, stop_timeout) => exit = if stop_exit == Exit::Ok { exit } else { stop_exit },
            name = signals.next() => {
                warn!("received a second {name}: ending at once, without waiting for unfinished work");
                exit = Exit::Software;
            }
        }
        exit
    }

    /// Waits until a signal arrives or a part ends. Returns the exit code.
    async fn watch(&mut self) -> Exit {
        let mut watchdog_timer = watchdog_timer();
        loop {
            tokio::select! {
                name = self.signals.next() => {
                    info!("received {name}: stopping");
                    return Exit::Ok;
                }
                name = wait_for_first_end(&self.parts) => {
                    error!("the {name} ended unexpectedly: stopping");
                    return Exit::Software;
                }
                () = wait_for_tick(&mut watchdog_timer) => notify(&[NotifyState::Watchdog]),
            }
        }
    }
}

/// Waits until the task of a part has ended in any way, including a panic. Returns the name of the part.
async fn wait_for_first_end(parts: &[Part]) -> &'static str {
    if parts.is_empty() {
        return std::future::pending().await;
    }
    let ends = parts.iter().map(|part| {
        Box::pin(async {
            part.ended.cancelled().await;
            part.name
        })
    });
    futures::future::select_all(ends).await.0
}

/// Stops the parts in reverse order, so that an agent sends its events before an aggregator in the same process
/// stops. A part that takes too long is aborted, so that each part after it has at least [`RESERVED_PER_PART`], or an
/// equal share of a short `stop_timeout`.
async fn stop_in_reverse(parts: Vec<Part>, stop_timeout: Duration) -> Exit {
    let deadline = Instant::now() + stop_timeout;
    let part_count = u32::try_from(parts.len()).unwrap_or(u32::MAX).max(1);
    // Without the minimum, the time reserved for later parts could use up a short timeout, and the first part would
    // be aborted at once.
    let reserved_per_part = RESERVED_PER_PART.min(stop_timeout / part_count);
    let mut exit = Exit::Ok;
    for (remaining_parts, mut part) in parts.into_iter().enumerate().rev() {
        part.stop.cancel();
        let reserved = reserved_per_part * u32::try_from(remaining_parts).unwrap_or(u32::MAX);
        match timeout_at(deadline.checked_sub(reserved).unwrap_or(deadline), &mut part.task).await {
            Ok(Ok(Ok(()))) => debug!("the {} has stopped", part.name),
            Ok(Ok(Err(problem))) => {
                error!("the {} failed: {}", part.name, error_line(&problem));
                exit = Exit::Software;
            }
            Ok(Err(panic)) => {
                error!("the {} panicked: {panic}", part.name);
                exit = Exit::Software;
            }
            Err(_elapsed) => {
                error!(
                    "the {} did not stop within its share of lifecycle.shutdown_deadline_s = {} s; it was aborted",
                    part.name,
                    stop_timeout.as_secs()
                );
                part.task.abort();
                exit = Exit::Software;
            }
        }
    }
    exit
}

/// Returns a timer with half the timeout of the service manager's watchdog; `None` without a watchdog.
fn watchdog_timer() -> Option<tokio::time::Interval> {
    // sd_watchdog_enabled(3) recommends half of the timeout.
    sd_notify::watchdog_enabled().map(|timeout| tokio::time::interval(timeout / 2))
}

/// Waits for the next tick of the timer; without a timer, waits forever.
async fn wait_for_tick(timer: &mut Option<tokio::time::Interval>) {
    match timer {
        Some(interval) => {
            interval.tick().await;
        }
        None => std::future::pending().await,
    }
}

/// Notifies the service manager; does nothing without one.
fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        warn!("cannot notify the service manager through NOTIFY_SOCKET: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a part that needs a moment to stop.
    fn part(name: &'static str) -> Part {
        let stop = CancellationToken::new();
        let stopped = stop.clone();
        let task = tokio::spawn(async move {
            stopped.cancelled().await;
            tokio::time::sleep(Duration::from_millis(10)).await;
            Ok(())
        });
        Part { name, stop, ended: CancellationToken::new(), task }
    }

    #[tokio::test]
    async fn short_deadline_leaves_time_for_each_part() {
        let parts = vec![part("aggregator"), part("web server"), part("agent")];
        assert_eq!(stop_in_reverse(parts, Duration::from_secs(1)).await, Exit::Ok);
    }
}
