//! Log lines about a model that loads for long.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use peernet_logger::Slug;

/// Time from the start of loading to the first line. The time between two lines doubles with each line.
const FIRST_REPORT: Duration = Duration::from_secs(30);

/// Log target of the lines. Programs that show no other log lines show these lines.
pub const LOAD_LOG_TARGET: &str = "peernet_inference::loading";

/// Logs that a model is still loading, until this is dropped.
// The first inference of a model may never end, and building an engine for a GPU may take many minutes.
pub(super) struct LoadWatch {
    /// Dropping it ends the thread that logs.
    loading: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl LoadWatch {
    /// Starts to watch the loading of a model on a device.
    pub(super) fn start(model: &Slug, device: &str) -> Self {
        let (loading, loaded) = sync_channel(0);
        let (model, device) = (model.clone(), device.to_owned());
        let report = move || {
            let mut next = FIRST_REPORT;
            let mut elapsed_s = 0;
            while loaded.recv_timeout(next) == Err(RecvTimeoutError::Timeout) {
                elapsed_s += next.as_secs();
                next *= 2;
                tracing::warn!(
                    target: LOAD_LOG_TARGET,
                    "model {model} is still loading on {device} after {elapsed_s} s: its files are read, or its first computation has not \
                     ended"
                );
            }
        };
        let thread = thread::Builder::new().name("load-watch".to_owned()).spawn(report);
        let thread = thread.inspect_err(
            |error| tracing::error!(%error, "cannot start the thread that reports long loading"),
        );
        Self { loading: Some(loading), thread: thread.ok() }
    }
}

impl Drop for LoadWatch {
    fn drop(&mut self) {
        drop(self.loading.take());
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that reports long loading panicked");
        }
    }
}
